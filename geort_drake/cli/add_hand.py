"""Describe a robot hand from its URDF, SDF or MJCF model, and check the description.

geort-drake add-hand my_hand.urdf
geort-drake train --hand models/hands/my_hand.yaml --output runs/my_hand
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from geort_drake.cli.options import add_json_option, command, finish, output_file, view, write_json
from geort_drake.errors import OutputError, UsageError
from geort_drake.files import require_writable
from geort_drake.resources import is_checkout, models_dir

if TYPE_CHECKING:
    from geort_drake.hands.description import HandDescription
    from geort_drake.hands.model import HandModel

EPILOG = """\
The model describes one hand with 2 to 5 fingers of revolute joints. The command proposes the fingers with
their joints, names and tips, the hand base B (+x out of the palm, +z along the fingers), the side, joints
that follow others, and contacts to ignore. Correct the description by hand, and check it again by giving it
in the model's place.

Exit codes: 0 the description was written, or checked; 2 the model or an option is unusable.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("model", type=Path, help="URDF, SDF or MJCF file; or a description (.yaml) to check")
    add("--name", help="of the hand (default: that of the file)")
    add(
        "--palm",
        metavar="LINK",
        help="link that carries the fingers (default: the one that most chains leave)",
    )
    folder = "models/hands/" if is_checkout() else ""
    add("--output", type=Path, metavar="FILE", help=f"description to write (default: {folder}NAME.yaml)")
    add("--overwrite", action="store_true", help="replace the description if it exists")
    add(
        "--hulls",
        action="store_true",
        help="in a copy, give links without collision geometry the convex hull of their visual geometry",
    )
    add("--rrd", type=output_file(".rrd"), metavar="FILE", help="Rerun recording of the hand to write")
    add_json_option(parser, "the findings")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake.console import say
    from geort_drake.hands.description import load_hand
    from geort_drake.hands.importers.checks import examine
    from geort_drake.hands.model import HandModel

    given: Path = arguments.model
    notes: list[str] = []
    if given.suffix in (".yaml", ".yml"):
        path, description = given, load_hand(given)
        if description.training:
            # Imported only here because it loads PyTorch.
            from geort_drake.comparison.train import DEFAULT_METHOD, training_config

            training_config(DEFAULT_METHOD, hand=description)
    else:
        path, description, notes = _describe(arguments)
    hand = HandModel(description)
    _print(description, hand)
    for note in notes:
        say(f"note: {note}")
    found = examine(hand)
    for text in found:
        say(f"correct: {text}")
    if not found:
        say("the checks found nothing to correct")
    if arguments.rrd is not None:
        from geort_drake.rerun.hand_view import record_hand

        record_hand(hand, arguments.rrd)
    write_json(arguments.json, {"description": str(path), "notes": notes, "to_correct": found})
    watch = [] if arguments.rrd is None else [view(arguments.rrd)]
    if found:
        following = command("add-hand", path)
    else:
        following = command("train", "--hand", path, "--output", Path("runs") / path.stem)
    finish({"Description": path}, *watch, following)
    return 0


def _describe(arguments: argparse.Namespace) -> "tuple[Path, HandDescription, list[str]]":
    """Writes a model's description; returns its path, the description and notes for the user."""
    from geort_drake.hands.importers.description_file import write_description
    from geort_drake.hands.importers.hulls import add_hulls
    from geort_drake.hands.importers.proposal import propose
    from geort_drake.hands.meshes import convert_model, what_drake_misreads

    given = arguments.model
    if arguments.output is not None and arguments.output.suffix not in (".yaml", ".yml"):
        raise UsageError(f"{arguments.output}: the name must end with .yaml")
    name = arguments.name or "".join(c if c.isalnum() else "_" for c in given.stem)
    folder = models_dir() / "hands" if is_checkout() else Path()
    path = arguments.output or folder / f"{name}.yaml"
    if path.exists() and not arguments.overwrite:
        raise OutputError(f"{path} exists; choose another --output, or give --overwrite")
    require_writable(path)
    model, notes = given, []
    misread = what_drake_misreads(given)
    if misread or arguments.hulls:
        model = convert_model(given, path.with_name(f"{path.stem}_model"))
        notes += [f"{what}; a corrected model is in {model.parent.name}" for what in misread]
    if arguments.hulls:
        links = ", ".join(add_hulls(model))
        notes.append(f"links that got the convex hull of their visual geometry: {links or 'none'}")
    proposal = propose(model, name, arguments.palm)
    notes += proposal.notes
    write_description(
        proposal.description, path, [f"Made by geort-drake add-hand from {given.name}.", *notes]
    )
    return path, proposal.description, notes


def _print(description: "HandDescription", hand: "HandModel") -> None:
    import numpy as np
    from rich.table import Table

    from geort_drake.console import console

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
