"""Makes the docs' pictures of recordings anew: records each kind, and photographs it without a screen."""

import argparse
import contextlib
import io
import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from rich.progress import track

from geort_drake.command_line import make_parser
from geort_drake.console import console, run_main
from geort_drake.errors import GeortError
from geort_drake.files import atomic_path, require_writable

ROOT = Path(__file__).resolve().parents[1]
SIZE = (1440, 900)  # px
# The viewer's menu, and its time controls with nothing of the recording on them, px.
TOP, BOTTOM = 37, 30
# A film shows what matters of a scene: left, top, right and bottom in shares of it.
FILM_PART = (0.20, 0.15, 0.93, 0.83)
FILM_HZ, FILM_QUALITY = 8, 60
EPILOG = """\
Everything is recorded from scratch, which takes as long as one training and one grasp. On a machine without a
graphics card, Rerun's viewer draws with Mesa's software driver (apt-get install mesa-vulkan-drivers).
"""


@dataclass(frozen=True)
class Picture:
    """One kind of recording, and when to photograph it.

    Attributes:
        record: makes the recording in a folder, for which `arguments` hold what was asked for.
        file: the recording, in that folder.
        time: on its timeline: s, or steps; None is the end.
        moves: whether it is a film of the scene from beginning to end.
    """

    record: Callable[[Path, argparse.Namespace], None]
    file: str
    time: float | None = None
    moves: bool = False


def main(argv: Sequence[str] | None = None) -> int:
    parser = make_parser(__doc__, EPILOG)
    add = parser.add_argument
    add("--only", nargs="+", choices=tuple(PICTURES), metavar="NAME", help=f"of {', '.join(PICTURES)}")
    add("--recording", type=Path, metavar="FILE", help="of a hand (default: synthetic play)")
    add("--retargeter", type=Path, metavar="DIR", help="checkpoint to use instead of training one")
    add(
        "--recordings", type=Path, default=Path("runs/pictures"), metavar="DIR", help="(default: %(default)s)"
    )
    add("--output", type=Path, default=ROOT / "docs" / "images", metavar="DIR", help="(default: %(default)s)")
    arguments = parser.parse_args(argv)
    require_writable(arguments.recordings, directory=True)
    require_writable(arguments.output, directory=True)
    folder = arguments.recordings.resolve()
    folder.mkdir(parents=True, exist_ok=True)

    for name in arguments.only or PICTURES:
        picture = PICTURES[name]
        console.print(f"[bold]{name}[/]")
        picture.record(folder, arguments)
        recording = folder / picture.file
        check(recording)
        file = arguments.output / f"{name}.{'webp' if picture.moves else 'png'}"
        if picture.moves:
            film(recording, file)
        else:
            photograph(recording, file, picture.time)
        console.print(f"Wrote {file}", soft_wrap=True)
    return 0


def check(recording: Path) -> None:
    """Has Rerun verify a recording.

    Raises:
        GeortError: it found something wrong.
    """
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(recording)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise GeortError(f"{recording}: rerun rrd verify says: {done.stderr.strip()}")


def photograph(recording: Path, picture: Path, time: float | None) -> None:
    """Writes a small .png of a recording, without the viewer's frame."""
    from geort_drake.systems._rerun_screenshot import take_screenshot

    take_screenshot(recording, picture, time=time, size=SIZE)
    with Image.open(picture) as whole, atomic_path(picture) as draft:
        cut = whole.convert("RGB").crop((0, TOP, whole.width, whole.height - BOTTOM))
        # An octree keeps the hues of thin lines, which a median cut gives up.
        cut.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(draft, optimize=True)


def film(recording: Path, picture: Path) -> None:
    """Writes a small moving .webp of a recording's scene, as fast as it was."""
    from geort_drake.systems._rerun_screenshot import camera

    with camera(recording, SIZE) as opened:
        times = np.arange(0, opened.end, 1 / FILM_HZ)
        shots = [opened.take(time, "scene") for time in track(times, "frames", console=console)]
    frames = []
    for shot in shots:
        with Image.open(io.BytesIO(shot)) as whole:
            part = np.array(FILM_PART) * (whole.size * 2)
            frames.append(whole.convert("RGB").crop(part.astype(int).tolist()))
    # The last instant stays for a while before it begins again.
    durations = [1000 // FILM_HZ] * (len(frames) - 1) + [1500]
    with atomic_path(picture) as draft:
        frames[0].save(
            draft, format="WEBP", save_all=True, append_images=frames[1:], duration=durations, loop=0,
            quality=FILM_QUALITY,
        )  # fmt: skip


def record_training(folder: Path, arguments: argparse.Namespace) -> None:
    """The training; its checkpoint is what the other recordings use."""
    run(
        "train_retargeter",
        *_recording(arguments),
        "--output",
        checkpoint(folder),
        "--rrd",
        folder / "training.rrd",
    )


def record_explorer(folder: Path, arguments: argparse.Namespace) -> None:
    """The trained method beside one that is not trained."""
    methods = ["--methods", retargeter(folder, arguments), "vector_online"]
    run("explore_retargeting", *_recording(arguments), *methods, "--output", folder / "explorer.rrd")


def record_grasp(folder: Path, arguments: argparse.Namespace) -> None:
    """A trial with the object that the README shows."""
    options = ["--objects", "cylinder", "--retargeter", retargeter(folder, arguments)]
    run("simulate_grasp", *options, "--output", folder / "grasp")


def record_objects(folder: Path, _arguments: argparse.Namespace) -> None:
    """The example of docs/rerun.md."""
    (code,) = (code for code in snippets(ROOT / "docs" / "rerun.md") if "objects.rrd" in code)
    with contextlib.chdir(folder):
        exec(compile(code, "docs/rerun.md", "exec"), {})


PICTURES = {
    "training": Picture(record_training, "training.rrd"),
    "explorer": Picture(record_explorer, "explorer.rrd", 4.0),
    "grasp": Picture(record_grasp, "grasp/cylinder-0.rrd", 5.0),
    "grasp_film": Picture(record_grasp, "grasp/cylinder-0.rrd", moves=True),
    "objects": Picture(record_objects, "objects.rrd", 0.7),
}


def run(script: str, *options: str | os.PathLike) -> None:
    """Runs one of the project's scripts.

    Raises:
        GeortError: it failed; it has said why.
    """
    command = [sys.executable, str(ROOT / "scripts" / f"{script}.py"), *map(str, options)]
    if subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode:
        raise GeortError(f"{script}.py did not finish")


def checkpoint(folder: Path) -> Path:
    """Where `record_training` leaves its checkpoint."""
    return folder / "geort_coupled"  # the name that the explorer shows


def retargeter(folder: Path, arguments: argparse.Namespace) -> Path:
    """The checkpoint to use; trained now if there is none."""
    if arguments.retargeter is not None:
        return arguments.retargeter
    if not checkpoint(folder).is_dir():
        record_training(folder, arguments)
    return checkpoint(folder)


def snippets(page: Path) -> list[str]:
    """The Python snippets of a page."""
    return re.findall(r"^```python\n(.*?)^```$", page.read_text("utf-8"), re.MULTILINE | re.DOTALL)


def _recording(arguments: argparse.Namespace) -> list:
    return [] if arguments.recording is None else ["--recording", arguments.recording]


if __name__ == "__main__":
    run_main(main)
