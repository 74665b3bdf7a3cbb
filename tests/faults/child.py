"""Runs a function in a child process with limits on time and memory, and reports how it ended.

Processes are forked from one that has imported the package already, so that each takes milliseconds.
"""

import dataclasses as dc
import multiprocessing
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

from geort_drake.console import run_main

MEMORY = 2 << 30  # bytes that a process may ask for beyond what the imports took
BUSY = 120  # s of CPU time; a process that takes more hangs
HANGING = 280.0  # s; one that lasts longer hangs as well, as it waits for something, also on a busy machine

_FORK = multiprocessing.get_context("forkserver")
_FORK.set_forkserver_preload(
    [
        "geort_drake.retargeting.geort",
        "geort_drake.benchmark.report",
        "geort_drake.simulation.trial",
        "geort_drake.rerun",
        "torch._dynamo",  # which torch imports when it first trains
    ]
)


@dc.dataclass(frozen=True)
class Ending:
    """How a process ended.

    Attributes:
        code: its exit code, or minus a signal's number; None if it hung and was stopped.
        error: name of the class of the exception that ended it, or empty.
        output: what it printed.
        seconds: how long it ran.
    """

    code: int | None
    error: str
    output: str
    seconds: float


class Child:
    """A process that runs `function(*arguments)` in `folder` like a command.

    Its output and its caches go to `beside`, so that `folder` holds only what it wrote.
    """

    def __init__(self, function: Callable, arguments: tuple, folder: Path, beside: Path, **limits: int):
        beside.mkdir(parents=True, exist_ok=True)
        self._files = [beside / name for name in ("error.txt", "output.txt")]
        for path in self._files:
            path.write_text("")
        self._started = time.perf_counter()
        self.process = _FORK.Process(target=_run, args=(function, arguments, folder, beside, limits))
        self.process.start()

    def wait(self, seconds: float = HANGING) -> Ending:
        """Waits for the end; ends the process if it hangs."""
        self.process.join(seconds)
        code = self.process.exitcode
        if code is None:
            self.kill()
        error, output = (path.read_text(errors="replace") for path in self._files)
        return Ending(code, error, output, time.perf_counter() - self._started)

    def kill(self) -> None:
        """kill -9."""
        self.process.kill()
        self.process.join()


def run(
    function: Callable, arguments: tuple, folder: Path, beside: Path, seconds: float = HANGING, **limits: int
) -> Ending:
    """Runs a `Child` to its end, which must come in so many seconds."""
    return Child(function, arguments, folder, beside, **limits).wait(seconds)


def _run(function: Callable, arguments: tuple, folder: Path, beside: Path, limits: dict[str, int]) -> None:
    os.environ["XDG_CACHE_HOME"] = str(beside / "cache")
    os.chdir(folder)
    # Opened before the limits on files.
    note, output = (os.open(beside / name, os.O_WRONLY) for name in ("error.txt", "output.txt"))
    for stream in (1, 2):
        os.dup2(output, stream)
    # Python's default, which the parent may have changed.
    sys.stderr.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limits = {"RLIMIT_AS": pages * resource.getpagesize() + MEMORY, "RLIMIT_CPU": BUSY, **limits}
    for name, limit in limits.items():
        resource.setrlimit(getattr(resource, name), (limit, limit))

    def main(_argv: object) -> int | None:
        try:
            return function(*arguments)
        except BaseException as error:
            os.write(note, type(error).__name__.encode())
            raise
        finally:
            sys.stdout.flush()
            sys.stderr.flush()

    run_main(main)
