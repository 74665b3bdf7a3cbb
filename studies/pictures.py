"""Makes the docs' pictures: records and photographs Rerun recordings without a display, or draws."""

import argparse
import contextlib
import io
import os
import runpy
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from rich.progress import track
from screenshots import photographs

from geort_drake.console import console, run_main
from geort_drake.errors import GeortError
from geort_drake.files import atomic_path, require_writable

ROOT = Path(__file__).resolve().parents[1]
SIZE = (1440, 900)  # px
# Heights of the viewer's menu and time controls, which are cropped, px.
TOP, BOTTOM = 37, 30
# Part of the window shown in a film, a row of views: left, top, right, bottom, as fractions of the window.
FILM_PART = (0.0, 0.075, 0.75, 0.484)
FILM_HZ, FILM_WIDTH, FILM_QUALITY = 8, 1200, 60
EPILOG = """\
Everything is recorded from scratch, which takes some minutes. On a machine without a
graphics card, Rerun's viewer draws with Mesa's software driver (apt-get install mesa-vulkan-drivers).
"""


@dataclass(frozen=True)
class Picture:
    """A recording and when to photograph it, or a drawing.

    Attributes:
        record: makes the recording or drawing in a folder, with the command's arguments.
        file: name of the recording or drawing (.png) in that folder.
        time: time of the recording, s; None for the end.
        moves: whether to make a film of the scene from beginning to end.
    """

    record: Callable[[Path, argparse.Namespace], None]
    file: str
    time: float | None = None
    moves: bool = False


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add(
        "--only",
        nargs="+",
        choices=tuple(PICTURES),
        metavar="NAME",
        help=f"pictures to make, of {', '.join(PICTURES)} (default: all)",
    )
    add("--recording", type=Path, metavar="FILE", help="recording to explore (default: synthetic play)")
    add("--retargeter", metavar="NAME", default="universal", help="method or map (default: universal)")
    add(
        "--glove",
        type=Path,
        metavar="FILE",
        help="recording to compare with synthetic play in human_play (default: none)",
    )
    add(
        "--recordings",
        type=Path,
        default=Path("runs/pictures"),
        metavar="DIR",
        help="folder for the recordings",
    )
    add(
        "--output",
        type=Path,
        default=ROOT / "docs" / "images",
        metavar="DIR",
        help="folder for the pictures",
    )
    arguments = parser.parse_args(argv)
    require_writable(arguments.recordings, directory=True)
    require_writable(arguments.output, directory=True)
    folder = arguments.recordings.resolve()
    folder.mkdir(parents=True, exist_ok=True)

    recorded = set()
    for name in arguments.only or PICTURES:
        picture = PICTURES[name]
        console.print(f"[bold]{name}[/]")
        if picture.record not in recorded:
            picture.record(folder, arguments)
            recorded.add(picture.record)
        source = folder / picture.file
        file = arguments.output / f"{name}.{'webp' if picture.moves else 'png'}"
        if source.suffix == ".png":
            with Image.open(source) as drawing:
                shrink(drawing, file)
        else:
            check(source)
            if picture.moves:
                film(source, file)
            else:
                photograph(source, file, picture.time)
        console.print(f"Picture: {file}", markup=False, soft_wrap=True)
    return 0


def check(recording: Path) -> None:
    """Has Rerun verify a recording.

    Raises:
        GeortError: the recording is faulty.
    """
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(recording)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise GeortError(f"{recording}: rerun rrd verify says: {done.stderr.strip()}")


def photograph(recording: Path, picture: Path, time: float | None) -> None:
    """Writes a small .png of a recording, without the viewer's controls."""
    (shot,) = photographs(recording, lambda end: [end if time is None else time], SIZE)
    with Image.open(io.BytesIO(shot)) as whole:
        shrink(whole.convert("RGB").crop((0, TOP, whole.width, whole.height - BOTTOM)), picture)


def shrink(image: Image.Image, picture: Path) -> None:
    """Writes a .png with few colours; transparency is kept."""
    # An octree keeps the hues of thin lines, which a median cut loses.
    few = image.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    with atomic_path(picture) as draft:
        few.save(draft, "PNG", optimize=True)


def film(recording: Path, picture: Path) -> None:
    """Writes a small animated .webp of the views of a recording's scene, in real time."""
    shots = photographs(recording, lambda end: np.arange(0, end, 1 / FILM_HZ), SIZE)
    frames = []
    for shot in track(shots, "frames", console=console):
        with Image.open(io.BytesIO(shot)) as whole:
            part = whole.convert("RGB").crop((np.array(FILM_PART) * (whole.size * 2)).astype(int).tolist())
        part.thumbnail((FILM_WIDTH, FILM_WIDTH), Image.Resampling.LANCZOS)
        frames.append(part)
    # The last frame is shown longer before the film repeats.
    durations = [1000 // FILM_HZ] * (len(frames) - 1) + [1500]
    with atomic_path(picture) as draft:
        frames[0].save(
            draft, format="WEBP", save_all=True, append_images=frames[1:], duration=durations, loop=0,
            quality=FILM_QUALITY,
        )  # fmt: skip


def record_explorer(folder: Path, arguments: argparse.Namespace) -> None:
    """Records a map and an untrained method in the explorer."""
    methods = ["--methods", arguments.retargeter, "affine_ik"]
    run("explore", *_recording(arguments), *methods, "--output", folder / "explorer.rrd")


def record_grasp(folder: Path, arguments: argparse.Namespace) -> None:
    """Records a trial with the object that the README shows."""
    options = ["--objects", "cylinder", "--retargeter", arguments.retargeter, *_recording(arguments)]
    run("grasp", *options, "--output", folder / "grasp")


def record_task(folder: Path, task: str, kind: str, case: str, settings: str = "{}") -> None:
    """Records a short trial of a task, with a method that needs no training."""
    options = ["--retargeter", "affine_ik", "--scenario-text", settings, "--output", folder / task]
    run("simulate", "--task", task, "--kind", kind, "--objects", case, *options)


def record_keys(folder: Path, _arguments: argparse.Namespace) -> None:
    """Records a few presses of keys."""
    record_task(folder, "keys", "adaptive", "keys", "{task_settings: {presses: 3, enough: 3}}")


def record_pick_place(folder: Path, _arguments: argparse.Namespace) -> None:
    """Records a block that is carried to its place."""
    record_task(folder, "pick_place", "servo", "block_20")


def record_peg(folder: Path, _arguments: argparse.Namespace) -> None:
    """Records a dowel that is inserted in a hole."""
    record_task(folder, "peg", "adaptive", "dowel")


def record_cap(folder: Path, _arguments: argparse.Namespace) -> None:
    """Records two strokes of the cap."""
    record_task(folder, "cap", "adaptive", "cap", "{task_settings: {turn: 90}}")


def record_hand(folder: Path, _arguments: argparse.Namespace) -> None:
    """Records synthetic play."""
    run("recording synthesize", "--output", folder / "play.npz")
    run("export", folder / "play.npz", "--output", folder / "hand.rrd", "--format", "rrd")


def record_capture(folder: Path, _arguments: argparse.Namespace) -> None:
    """Records the capture protocol."""
    run("recording protocol", "--output", folder / "capture.rrd")


def record_add_hand(folder: Path, _arguments: argparse.Namespace) -> None:
    """Records the LEAP hand as `hand add` describes it from its model."""
    output = ["--output", folder / "leap.yaml", "--overwrite"]
    run("hand add", ROOT / "models" / "sdf" / "leap_right.sdf", *output, "--rrd", folder / "add_hand.rrd")


def draw_human_play(folder: Path, arguments: argparse.Namespace) -> None:
    """Draws synthetic play, and a glove's recording if there is one."""
    compared = [] if arguments.glove is None else ["--glove", arguments.glove]
    draw("human_play", folder / "human_play.png", *compared)


def draw_people(folder: Path, _arguments: argparse.Namespace) -> None:
    """Draws hands of the population."""
    draw("people", "--output", folder / "people.png")


def record_objects(folder: Path, _arguments: argparse.Namespace) -> None:
    """Records the example of docs/how-to/record-with-rerun.md."""
    with contextlib.chdir(folder):
        runpy.run_path(str(ROOT / "examples" / "falling_objects.py"))


PICTURES = {
    "explorer": Picture(record_explorer, "explorer.rrd", 4.0),
    "grasp": Picture(record_grasp, "grasp/cylinder-0.rrd", 6.6),
    "grasp_film": Picture(record_grasp, "grasp/cylinder-0.rrd", moves=True),
    "keys": Picture(record_keys, "keys/keys-0.rrd", 6.9),
    "pick_place": Picture(record_pick_place, "pick_place/block_20-0.rrd", 6.3),
    "peg": Picture(record_peg, "peg/dowel-0.rrd", 15.0),
    "cap": Picture(record_cap, "cap/cap-0.rrd", 6.0),
    "objects": Picture(record_objects, "objects.rrd", 0.7),
    "hand": Picture(record_hand, "hand.rrd", 12.0),
    "capture": Picture(record_capture, "capture.rrd", 66.0),
    "add_hand": Picture(record_add_hand, "add_hand.rrd", 4.0),
    "human_play": Picture(draw_human_play, "human_play.png"),
    "people": Picture(draw_people, "people.png"),
}


def run(command: str, *options: str | os.PathLike) -> None:
    """Runs a command of `geort-drake`.

    Raises:
        GeortError: the command failed; it has printed why.
    """
    _call("-m", "geort_drake", *command.split(), *options)


def draw(study: str, *options: str | os.PathLike) -> None:
    """Runs a program beside this one; raises GeortError as `run` does."""
    _call(ROOT / "studies" / f"{study}.py", *options)


def _call(*words: str | os.PathLike) -> None:
    line = [str(word) for word in words]
    if subprocess.run([sys.executable, *line], stdout=subprocess.DEVNULL, check=False).returncode:
        raise GeortError(f"{' '.join(line)} did not finish")


def _recording(arguments: argparse.Namespace) -> list:
    return [] if arguments.recording is None else ["--recording", arguments.recording]


if __name__ == "__main__":
    run_main(main)
