"""Describe a robot hand from its URDF, SDF or MJCF model, or check a description.

geort-drake add-hand my_hand.urdf
geort-drake train --hand my_hand.yaml --output runs/my_hand
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from geort_drake.cli.options import CommandParser, command, finish, output_file, view, write_json
from geort_drake.errors import OutputError, UsageError, listed
from geort_drake.files import require_writable

if TYPE_CHECKING:
    from geort_drake.hands.description import HandDescription
    from geort_drake.hands.model import HandModel

EPILOG = """\
The model must be one hand with 2 to 5 fingers of revolute joints. The command proposes the fingers with their
joints, names and tips, the hand base B (+x out of the palm, +z along the fingers), the side, coupled joints,
and contacts to ignore. Correct the description by hand, then check it: give its file instead of the model.

Exit codes: 0 the description was written or checked; 2 the model or an option is invalid.
"""


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("model", type=Path, help="URDF, SDF or MJCF file; or a description (.yaml) to check")
    add("--name", help="name of the hand (default: the file's)")
    add(
        "--palm",
        metavar="LINK",
        help="link that carries the fingers (default: where most joint chains start)",
    )
    add("--output", type=Path, metavar="FILE", help="description to write (default: NAME.yaml)")
    add("--overwrite", action="store_true", help="replace the description if it exists")
    hulls = (
        "write a copy in which links without collision geometry collide with their visual geometry's hulls"
    )
    add("--hulls", action="store_true", help=hulls)
    add("--rrd", type=output_file(".rrd"), metavar="FILE", help="also write a Rerun recording of the hand")
    parser.add_json("the findings")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import HandModel, load_hand
    from geort_drake.console import print_table, say
    from geort_drake.hands.importers.checks import examine

    given: Path = arguments.model
    notes: list[str] = []
    if given.suffix in (".yaml", ".yml"):
        path, description = given, load_hand(given)
    else:
        path, description, notes = _describe(arguments)
    hand = HandModel(description)
    columns = ("finger", "joints, base to tip", "follow", "tip link", "tip radius", "reach")
    title = f"{description.name}, a {description.side} hand of {len(hand.joint_names)} joints"
    print_table(columns, _rows(hand), title, text=columns[1:4])
    for note in notes:
        say(f"note: {note}")
    found = examine(hand)
    for text in found:
        say(f"correct: {text}")
    if not found:
        say("the checks found nothing to correct")
    if arguments.rrd is not None:
        from geort_drake.export.hand_recordings import write_joint_sweep

        write_joint_sweep(hand, arguments.rrd)
    write_json(arguments.json, {"description": str(path), "notes": notes, "to_correct": found})
    if found:
        following = command("add-hand", path)
    else:
        following = command("train", "--hand", path, "--output", Path("runs") / path.stem)
    finish({"Description": path}, view(arguments.rrd), following)
    return 0


def _describe(arguments: argparse.Namespace) -> "tuple[Path, HandDescription, list[str]]":
    """Writes a model's description; returns its path, the description and notes for the user."""
    from geort_drake.hands.description import write_description
    from geort_drake.hands.importers.conversion import add_collisions, convert_model, unreadable_meshes
    from geort_drake.hands.importers.proposal import propose

    given = arguments.model
    if arguments.output is not None and arguments.output.suffix not in (".yaml", ".yml"):
        raise UsageError(f"{arguments.output}: the name must end with .yaml")
    name = arguments.name or "".join(c if c.isalnum() else "_" for c in given.stem)
    path = arguments.output or Path(f"{name}.yaml")
    if path.exists() and not arguments.overwrite:
        raise OutputError(f"{path} exists; choose another --output, or give --overwrite")
    require_writable(path)
    model = given
    notes: list[str] = []
    meshes = listed([mesh.name for mesh in unreadable_meshes(given)])
    if meshes or arguments.hulls:
        model = convert_model(given, path.with_name(f"{path.stem}_model"), notes)
    if meshes:
        notes.append(f"in the copy in {model.parent.name}, convex hulls replace {meshes}")
    if arguments.hulls:
        links = listed(add_collisions(model))
        notes.append(f"links with collision geometry made from their visual geometry: {links or 'none'}")
    proposal = propose(model, name, arguments.palm)
    notes += proposal.notes
    write_description(
        proposal.description, path, [f"Made by geort-drake add-hand from {given.name}.", *notes]
    )
    return path, proposal.description, notes


def _rows(hand: "HandModel") -> Iterator[tuple[str, ...]]:
    """Yields a table row per finger."""
    import numpy as np

    p_BF = hand.fingertips(hand.sample(200))
    for number, finger in enumerate(hand.description.fingers):
        chain = hand.kinematics().fingers[number]
        followers = [joint for joint in chain.all_joint_names if joint not in chain.joint_names]
        reach = np.linalg.norm(p_BF[:, number] - chain.X_PJ[0, :3, 3], axis=1).max()
        yield (
            finger.name,
            " ".join(finger.joints),
            " ".join(followers),
            finger.tip_link,
            f"{1e3 * finger.tip_radius:.1f} mm",
            f"{1e3 * reach:.0f} mm",
        )
