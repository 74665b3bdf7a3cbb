"""Commands for robot hands: describe one, list those that are known by name."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from geort_drake.cli.base import (
    Command,
    Json,
    OutputFile,
    command,
    finish,
    options,
    view,
    write_json,
)
from geort_drake.errors import OutputError, UsageError, listed
from geort_drake.files import require_writable

if TYPE_CHECKING:
    from geort_drake.hands.description import HandDescription
    from geort_drake.hands.hand import Hand


@options
class AddHand(Command):
    """Describe a robot hand from its URDF, SDF or MJCF model, or check a description.

      geort-drake hand add my_hand.urdf
      geort-drake train --universal --hand my_hand.yaml --output my_hand.safetensors

    The model must be one hand with 2 to 5 fingers of revolute joints. The command proposes the fingers with
    their joints, names and tips, the hand base B (+x out of the palm, +z along the fingers), the side,
    coupled joints, and contacts to ignore. Correct the description by hand, then check it: give its file
    instead of the model.

    Exit codes: 0 the description was written or checked; 2 the model or an option is invalid.
    """

    model: Positional[Path]
    """URDF, SDF or MJCF file; or a description (.yaml) to check"""
    name: str | None = None
    """name of the hand (default: the file's)"""
    palm: Annotated[str | None, arg(metavar="LINK")] = None
    """link that carries the fingers (default: where most joint chains start)"""
    output: Annotated[Path | None, arg(metavar="FILE")] = None
    """description to write (default: NAME.yaml)"""
    overwrite: bool = False
    """replace the description if it exists"""
    hulls: bool = False
    """let links without collision geometry collide as they are drawn, meshes as their hulls"""
    rrd: Annotated[Path | None, arg(metavar="FILE"), OutputFile(".rrd")] = None
    """also write a Rerun recording of the hand (.rrd)"""
    json: Json = None

    def run(self) -> int:
        from geort_drake.console import print_table, say
        from geort_drake.hands.description import load_hand
        from geort_drake.hands.hand import Hand
        from geort_drake.hands.importers.checks import examine

        notes: list[str] = []
        if self.model.suffix in (".yaml", ".yml"):
            path, description = self.model, load_hand(self.model)
        else:
            path, description, notes = self._describe()
        hand = Hand(description)
        columns = ("finger", "joints, base to tip", "coupled joints", "tip link", "tip radius", "reach")
        title = f"{description.name}, a {description.side} hand of {len(hand.joint_names)} joints"
        print_table(columns, _rows(hand), title, text=columns[1:4])
        for note in notes:
            say(f"note: {note}")
        faults = examine(hand)
        for text in faults:
            say(f"fix: {text}")
        if not faults:
            say("the checks found nothing to fix")
        if self.rrd is not None:
            from geort_drake.export.hand_recordings import write_joint_sweep

            write_joint_sweep(hand, self.rrd)
        write_json(self.json, {"description": str(path), "notes": notes, "to_fix": faults})
        if faults:
            following = command("hand", "add", path)
        else:
            following = command("train", "--universal", hand=path, output=Path(f"{path.stem}.safetensors"))
        finish({"Description": path}, view(self.rrd), following)
        return 0

    def _describe(self) -> "tuple[Path, HandDescription, list[str]]":
        """Writes a model's description; returns its path, the description and notes for the user."""
        from geort_drake.hands.description import write_description
        from geort_drake.hands.importers.conversion import convert_model, unreadable_meshes
        from geort_drake.hands.importers.proposal import propose

        source = self.model
        if self.output is not None and self.output.suffix not in (".yaml", ".yml"):
            raise UsageError(f"{self.output}: the name must end with .yaml")
        name = self.name or "".join(c if c.isalnum() else "_" for c in source.stem)
        path = self.output or Path(f"{name}.yaml")
        if path.exists() and not self.overwrite:
            raise OutputError(f"{path} exists; choose another --output, or give --overwrite")
        require_writable(path)
        model = source
        notes: list[str] = []
        if meshes := unreadable_meshes(source):
            model = convert_model(source, path.with_name(f"{path.stem}_model"))
            names = listed([mesh.name for mesh in meshes])
            notes.append(f"in the copy in {model.parent.name}, convex hulls replace {names}")
            if any(mesh.suffix.lower() == ".glb" for mesh in meshes):
                notes.append("the .glb meshes are taken to have z up, not y as in glTF; check their hulls")
        description, guesses = propose(model, name, self.palm, self.hulls)
        notes += guesses
        write_description(description, path, [f"Made by geort-drake hand add from {source.name}.", *notes])
        return path, description, notes


@options
class ListHands(Command):
    """List the hands that are known by name, their universal maps, and how to get their models.

    You need no model to use a map, but you do for training, evaluation and simulation.
    """

    json: Json = None

    def run(self) -> int:
        from geort_drake import load_hand
        from geort_drake.console import print_table, say
        from geort_drake.errors import HandError
        from geort_drake.hands.model_search import find_model
        from geort_drake.resources import hand_names
        from geort_drake.retargeting.store import shipped_maps

        maps, rows = shipped_maps(), []
        missing: dict[str, list[str]] = {}  # how to get a model → hands
        for name in hand_names():
            hand = load_hand(name)
            try:
                find_model(hand)
                model = "at hand"
            except HandError:
                model = "missing"
                if hand.source.get:
                    missing.setdefault(hand.source.get, []).append(name)
            has_map = "yes" if name in maps else "no"
            rows.append((name, hand.side, ", ".join(hand.finger_names), has_map, model, hand.source.get))
        columns = ("hand", "side", "fingers", "map", "model")
        print_table(columns, [row[:-1] for row in rows], text=columns[1:])
        for get, names in missing.items():  # outside of the table, where a line can be copied
            say(f"model of {', '.join(names)}: {get}")
        write_json(self.json, [dict(zip(("name", *columns[1:], "get"), row, strict=True)) for row in rows])
        finish({}, command("hand", "add", "my_hand.urdf"))
        return 0


def _rows(hand: "Hand") -> Iterator[tuple[str, ...]]:
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
