"""Programs that are killed: what they leave, and how they resume.

A result is complete or absent, whatever happens.
"""

import dataclasses as dc
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from faults.child import Child, run
from faults.works import WORKS, results

MAX_TIME = 900.0  # s that a program may take, also on a busy machine
MAX_WORKER_TIME = 30.0  # s after which a killed program's workers must have ended, also on a busy machine
TESTS = Path(__file__).resolve().parents[1]


@dc.dataclass(frozen=True)
class Reference:
    """What a program does when it is not disturbed.

    Attributes:
        work: the program's name.
        folder: results of an earlier run with another seed.
        earlier, later: results before and after the run.
        seconds: how long the run takes.
        events: how many operations on files it makes.
    """

    work: str
    folder: Path
    earlier: dict[str, str]
    later: dict[str, str]
    seconds: float
    events: int


def reference(work: str, folder: Path) -> Reference:
    """Runs a program twice, first with another seed, in a new folder."""
    room, beside = folder / "reference", folder / "beside"
    room.mkdir(parents=True)
    endings, found = [], []
    for seed in (1, 0):
        endings.append(run(_work, (work, seed, -1), room, beside, MAX_TIME))
        if endings[-1].code != 0:
            raise RuntimeError(f"a run without a fault ended with {endings[-1]}")
        found.append(results(room))
        shutil.copytree(room, folder / str(seed))
    events = int((beside / "events.txt").read_text())
    return Reference(work, folder / "1", *found, endings[1].seconds, events)


def kill(
    known: Reference, folder: Path, rng: np.random.Generator, by_clock: bool, new_interpreter: bool = False
) -> list[str]:
    """Kills a run at a random moment, checks what is left, and runs the program again.

    Args:
        known: the program and its results without a kill.
        folder: for its files.
        rng: chooses the moment.
        by_clock: at a random time; otherwise between two operations on files.
        new_interpreter: whether the second run is in an interpreter with other hashes and more threads.

    Returns:
        What is wrong: results lost, incomplete, made twice or different, or processes left over.
    """
    room = folder / "room"
    shutil.copytree(known.folder, room)
    if by_clock:
        child = Child(_work, (known.work, 0, None), room, folder / "beside")
        time.sleep(float(rng.uniform(0.0, known.seconds)))
        child.kill()
    else:
        event = int(rng.integers(1, known.events + 1))
        ending = run(_work, (known.work, 0, event), room, folder / "beside", MAX_TIME)
        if ending.code != -signal.SIGKILL:
            return [f"was not killed at event {event}: {ending}"]
    wrong, left = _check_left(known, room)
    wrong += [f"process {process} was left over" for process in _left_over(room)]
    if new_interpreter:
        code, output = _run_in_new_interpreter(known.work, room, folder / "other cache")
    else:
        ending = run(_work, (known.work, 0, None), room, folder / "beside", MAX_TIME)
        code, output = ending.code, ending.output
    if code != 0:
        return [*wrong, f"did not resume: {code} {output}"]
    after = results(room)
    if after != known.later:
        wrong.append("the results differ from those without the kill")
    if known.work.startswith("benchmark") and list(after)[: len(left)] != list(left):
        wrong.append("a finished trial was made again")
    return wrong


def _check_left(known: Reference, room: Path) -> tuple[list[str], dict[str, str]]:
    """Returns what is wrong with the results that a broken run left, and these results."""
    try:
        left = results(room)
    except Exception as error:
        return [f"an incomplete result was left: {error}"], {}
    wrong = [
        f"{name} is neither the earlier nor the later one"
        for name, digest in left.items()
        if digest not in (known.earlier.get(name), known.later.get(name))
    ]
    return wrong + [f"{name} was lost" for name in known.earlier if name not in left], left


def _left_over(room: Path) -> list[str]:
    """Returns processes that still run in a folder after `MAX_WORKER_TIME`."""
    deadline = time.monotonic() + MAX_WORKER_TIME
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
    """Runs a program in the child. It kills itself at that operation on files; -1 only counts them."""
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
    result = WORKS[name](seed)
    if die_at == -1:
        Path(os.environ["XDG_CACHE_HOME"]).with_name("events.txt").write_text(str(counted))
    return result


def _run_in_new_interpreter(work: str, room: Path, cache: Path) -> tuple[int, str]:
    program = f"import sys; sys.path.insert(0, {str(TESTS)!r}); from faults.works import WORKS; "
    program += f"WORKS[{work!r}](0)"
    environment = os.environ | {"PYTHONHASHSEED": "8", "OMP_NUM_THREADS": "2", "XDG_CACHE_HOME": str(cache)}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=room, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stderr[-2000:]


def _touches(event: str, arguments: tuple, folder: str) -> bool:
    """Returns whether an audit event is about to change something in a folder."""
    if event == "open":
        mode = arguments[1]
        changes = isinstance(mode, str) and any(letter in mode for letter in "wax+")
    else:
        changes = event in ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "shutil.rmtree")
    inside = changes and isinstance(arguments[0], str | os.PathLike)
    return inside and os.path.abspath(os.fspath(arguments[0])).startswith(folder)
