"""Programs that are killed at any moment, or find the disk full: what they leave, and how they go on.

Their results are whole or absent, whatever happens.
"""

import dataclasses as dc
import os
import re
import shutil
import signal
import sys
import time
from pathlib import Path

import numpy as np

from faults.child import Child, Ending, run
from faults.works import WORKS, Work

TIME = 900.0  # s that a work may take, also on a busy machine
NOTICED = 30.0  # s after which a killed program's worker must have ended, also on a busy machine


@dc.dataclass(frozen=True)
class Reference:
    """What a work gives when nothing happens to it.

    Attributes:
        folder: with the results of an earlier run, of another seed.
        earlier, later: results before and after the run.
        seconds: how long the run takes.
        events: how often it opens, renames, makes or removes something.
    """

    folder: Path
    earlier: dict[str, str]
    later: dict[str, str]
    seconds: float
    events: int


def reference(work: Work, folder: Path) -> Reference:
    """Runs a work twice, first with another seed, in a folder of its own."""
    room = folder / "reference"
    room.mkdir(parents=True)
    _ended_well(run(_work, (work.name, 1, None), room, folder / "beside", TIME))
    earlier = work.results(room)
    shutil.copytree(room, folder / "earlier")
    ending = _ended_well(run(_work, (work.name, 0, -1), room, folder / "beside", TIME))
    events = int((folder / "beside" / "events.txt").read_text())
    return Reference(folder / "earlier", earlier, work.results(room), ending.seconds, events)


def kill(work: Work, known: Reference, folder: Path, rng: np.random.Generator, by_clock: bool) -> list[str]:
    """Kills a run at a random moment, looks at what is left, and runs it again.

    Args:
        by_clock: at a time; otherwise at a moment between two things that it does to files.

    Returns:
        What is wrong; nothing, where no result was lost, half, or made twice, and no process left over.
    """
    room = folder / "room"
    shutil.copytree(known.folder, room)
    if by_clock:
        child = Child(_work, (work.name, 0, None), room, folder / "beside")
        time.sleep(float(rng.uniform(0.0, known.seconds)))
        child.kill()
    else:
        at = int(rng.integers(1, known.events + 1))
        ending = run(_work, (work.name, 0, at), room, folder / "beside", TIME)
        if ending.code != -signal.SIGKILL:
            return [f"was not killed at event {at}: {ending}"]
    wrong, left = _looked_at(work, known, room)
    wrong += [f"process {process} was left over" for process in _left_over(room)]
    ending = run(_work, (work.name, 0, None), room, folder / "beside", TIME)
    if ending.code != 0:
        return [*wrong, f"did not go on: {ending}"]
    after = work.results(room)
    if after != known.later:
        wrong.append("the results are others than without the kill")
    if not work.replaces and list(after.items())[: len(left)] != list(left.items()):
        wrong.append("a finished trial was made again")
    return wrong


def full_disk(work: Work, known: Reference, folder: Path, limit: int) -> list[str]:
    """Lets no file grow beyond `limit` bytes; then runs without the limit. What is wrong with that."""
    room = folder / "room"
    shutil.copytree(known.folder, room)
    ending = run(_work, (work.name, 0, None), room, folder / "beside", TIME, RLIMIT_FSIZE=limit)
    wrong, _ = _looked_at(work, known, room)
    wrong += unclear(ending, "File too large|is the disk full")
    wrong += [f"left {path.name}" for path in room.rglob(".*")]
    ending = run(_work, (work.name, 0, None), room, folder / "beside", TIME)
    if ending.code != 0 or work.results(room) != known.later:
        wrong.append(f"did not go on: {ending}")
    return wrong


def unclear(ending: Ending, reason: str) -> list[str]:
    """What is wrong with the end of a program that could not write: it should name a file and the reason."""
    wrong = []
    if (ending.code, ending.error) != (2, "OutputError"):
        wrong.append(f"ended with {ending.code} {ending.error}")
    if not re.search(f"cannot be written.*: ({reason})", ending.said) or "Traceback" in ending.said:
        wrong.append(f"said {ending.said[-500:]}")
    return wrong


def _looked_at(work: Work, known: Reference, room: Path) -> tuple[list[str], dict[str, str]]:
    """What is wrong with the results that a broken run left, and these."""
    wrong = []
    try:
        left = work.results(room)
    except Exception as error:
        return [f"half a result was left: {error}"], {}
    for name, digest in left.items():
        if digest not in (known.earlier.get(name), known.later.get(name)):
            wrong.append(f"{name} is neither the earlier nor the later one")
    wrong += [f"{name} was lost" for name in known.earlier if name not in left]
    return wrong, left


def _left_over(room: Path) -> list[str]:
    """Processes that are still in a folder after a time in which they should have noticed."""
    deadline = time.monotonic() + NOTICED
    while processes := [path.name for path in Path("/proc").glob("[0-9]*") if _is_in(path, room)]:
        if time.monotonic() > deadline:
            return processes
        time.sleep(0.1)
    return []


def _is_in(process: Path, room: Path) -> bool:
    try:
        return Path(os.readlink(process / "cwd")) == room.resolve()
    except OSError:  # it has ended, or is another user's
        return False


def _work(name: str, seed: int, die_at: int | None) -> object:
    """In the child: the work, which kills itself at a file event of that number (-1 counts them only)."""
    counted = 0
    if die_at is not None:
        folder = os.getcwd()

        def hook(event: str, arguments: tuple) -> None:
            nonlocal counted
            if _touches(event, arguments, folder):
                counted += 1
                if counted == die_at:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(hook)
    result = WORKS[name].main(seed)
    if die_at == -1:
        # Beside the room, as its caches are.
        Path(os.environ["XDG_CACHE_HOME"]).with_name("events.txt").write_text(str(counted))
    return result


def _touches(event: str, arguments: tuple, folder: str) -> bool:
    """Whether an audit event is about to change something in a folder."""
    if event == "open":
        path, mode, _ = arguments
        changes = isinstance(mode, str) and any(letter in mode for letter in "wax+")
        return changes and isinstance(path, str | os.PathLike) and _inside(path, folder)
    if event in ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "shutil.rmtree"):
        return isinstance(arguments[0], str | os.PathLike) and _inside(arguments[0], folder)
    return event == "ctypes.dlsym" and arguments[1] == "renameat2"


def _inside(path: str | os.PathLike, folder: str) -> bool:
    return os.path.abspath(os.fspath(path)).startswith(folder)


def _ended_well(ending: Ending) -> Ending:
    if ending.code != 0:
        raise RuntimeError(f"a run without a fault ended with {ending}")
    return ending
