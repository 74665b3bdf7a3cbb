"""Describes a robot hand from its model file, checks the description, and says what to correct.

python scripts/add_hand.py my_hand.urdf
python scripts/train_retargeter.py --hand models/hands/my_hand.yaml --output runs/my_hand
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from geort_drake.cli.console import console, run_main
from geort_drake.cli.options import add_json_option, check_outputs, command, make_parser, write_json
from geort_drake.errors import OutputError
from geort_drake.files import require_writable
from geort_drake.hands.description import HandDescription, load_hand
from geort_drake.hands.importers.checks import examine
from geort_drake.hands.importers.description_file import write_description
from geort_drake.hands.importers.hulls import add_hulls
from geort_drake.hands.importers.proposal import propose
from geort_drake.hands.meshes import convert_model, what_drake_misreads
from geort_drake.hands.model import HandModel
from geort_drake.resources import models_dir

EPILOG = """\
The model is a URDF, SDF or MJCF file that Drake reads, of one hand with 2 to 5 fingers of revolute joints.
What is proposed are the fingers with their joints, names and tips, the hand base B (+x out of the palm, +z
along the fingers), the side, the joints that follow others, and contacts that do not count. Correct the
description by hand and check it again by giving it in the model's place.

Exit codes: 0 the description was written, or checked; 2 the model or something asked for is unusable.
"""


def main(argv: Sequence[str] | None = None) -> None:
    arguments = parse_arguments(argv)
    given: Path = arguments.model
    notes: list[str] = []
    if given.suffix in (".yaml", ".yml"):
        path, description = given, load_hand(given)
        if description.training:
            # Only here, as it loads PyTorch.
            from geort_drake.comparison.train import DEFAULT_METHOD, training_config

            training_config(DEFAULT_METHOD, hand=description)
    else:
        name = arguments.name or "".join(c if c.isalnum() else "_" for c in given.stem)
        path = arguments.output or models_dir() / "hands" / f"{name}.yaml"
        if path.exists() and not arguments.overwrite:
            raise OutputError(f"{path} exists; choose another --output, or give --overwrite")
        require_writable(path)
        model = given
        misread = what_drake_misreads(given)
        if misread or arguments.hulls:
            model = convert_model(given, path.with_name(f"{path.stem}_model"))
            notes += [f"{what}; a model that has it right is in {model.parent.name}" for what in misread]
        if arguments.hulls:
            links = ", ".join(add_hulls(model))
            notes.append(f"links that were given the convex hull of what is drawn: {links or 'none'}")
        proposal = propose(model, name, arguments.palm)
        description = proposal.description
        notes += proposal.notes
        write_description(description, path, [f"Made by add_hand.py from {given.name}.", *notes])
    hand = HandModel(description)
    _print(description, hand)
    for note in notes:
        console.print(f"note: {note}", markup=False, soft_wrap=True)
    found = examine(hand)
    for text in found:
        console.print(f"correct: {text}", markup=False, soft_wrap=True)
    if not found:
        console.print("the checks found nothing to correct")
    if arguments.rrd is not None:
        # Only here, so that a check does not load Rerun.
        from geort_drake.rerun.hand_view import record_hand

        record_hand(hand, arguments.rrd)
    write_json(arguments.json, {"description": str(path), "notes": notes, "to_correct": found})
    lines = {"Description": str(path)}
    if arguments.rrd is not None:
        lines["Look at it"] = command("rerun", arguments.rrd)
    if found:
        lines["Check it again after corrections"] = command("add_hand.py", path)
    else:
        output = Path("runs") / path.stem
        lines["Train it"] = command("train_retargeter.py", "--hand", path, "--output", output)
    for what, line in lines.items():
        console.print(f"{what}: {line}", markup=False, soft_wrap=True)


def _print(description: HandDescription, hand: HandModel) -> None:
    table = Table(title=f"{description.name}, a {description.side} hand of {len(hand.joint_names)} joints")
    for column in ("finger", "joints, base to tip", "follow", "tip link", "tip radius", "reach"):
        right = column in ("tip radius", "reach")
        table.add_column(column, justify="right" if right else "left", overflow="fold")
    rng = np.random.default_rng(0)
    p_BF = hand.fingertips(rng.uniform(hand.lower, hand.upper, (200, len(hand.joint_names))))
    for number, finger in enumerate(description.fingers):
        chain = hand.kinematics().fingers[number]
        followers = [joint for joint in chain.all_joint_names if joint not in chain.joint_names]
        reach = np.linalg.norm(p_BF[:, number] - chain.X_PJ[0, :3, 3], axis=1).max()
        table.add_row(
            finger.name,
            " ".join(finger.joints),
            " ".join(followers),
            finger.tip_link,
            f"{1e3 * finger.tip_radius:.1f} mm",
            f"{1e3 * reach:.0f} mm",
        )
    console.print(table)


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__, EPILOG)
    parser.add_argument("model", type=Path, help="URDF, SDF or MJCF file; or a description (.yaml) to check")
    parser.add_argument("--name", help="of the hand (default: that of the file)")
    parser.add_argument(
        "--palm", metavar="LINK", help="that carries the fingers (default: the one that most chains leave)"
    )
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help="description to write (default: models/hands/NAME.yaml)"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace the description if it exists")
    parser.add_argument(
        "--hulls",
        action="store_true",
        help="give links without collision geometry the convex hull of what is drawn of them, in a copy",
    )
    parser.add_argument("--rrd", type=Path, metavar="FILE", help="Rerun recording of the hand to write")
    add_json_option(parser, "what was found")
    arguments = parser.parse_args(argv)
    if arguments.output is not None and arguments.output.suffix not in (".yaml", ".yml"):
        parser.error(f"{arguments.output}: the name must end with .yaml")
    check_outputs(parser, (arguments.rrd, ".rrd"))
    return arguments


if __name__ == "__main__":
    run_main(main)
