"""Runs a hostile input and checks that the program refuses it properly."""

import dataclasses as dc
import hashlib
import re
import stat
from collections.abc import Callable
from pathlib import Path

from faults.child import run
from geort_drake.cli import run_command


@dc.dataclass(frozen=True)
class Case:
    """An input that must be refused.

    Attributes:
        kind: recording, checkpoint, scenario, hand or command.
        name: what is wrong with it.
        make: writes the input into a folder and returns a command and its arguments, or a function and its
            arguments.
        error: class name of the expected error, or several separated by |.
        message: pattern that the message must match.
    """

    kind: str
    name: str
    make: Callable[[Path], tuple]
    error: str
    message: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.name}"


def faults_of(case: Case, folder: Path) -> list[str]:
    """Runs a case in an empty folder and returns what is wrong with its refusal.

    Expected are the named error, exit code 2, the message without a traceback, an end in time and within the
    memory, and no file written.
    """
    room = folder / "room"
    room.mkdir(parents=True)
    command, *arguments = case.make(room)
    before = contents(room)
    if isinstance(command, str):
        command, arguments = run_command, [command, [str(word) for word in arguments]]
    ending = run(command, tuple(arguments), room, folder / "beside")
    checks = {
        f"hung for {ending.seconds:.0f} s": ending.code is None,
        f"exit code {ending.code}": ending.code not in (2, None),
        f"error {ending.error or 'none'}, not {case.error}": not re.fullmatch(case.error, ending.error),
        f"does not match {case.message!r}": not re.search(case.message, ending.output, re.DOTALL),
        "a traceback": "Traceback" in ending.output,
        "a file was written": contents(room) != before,
    }
    wrong = [text for text, failed in checks.items() if failed]
    return [*wrong, ending.output[-2000:]] if wrong else []


def contents(folder: Path) -> dict[str, str]:
    """Returns every path below a folder with its mode, and for regular files the digest of their contents."""
    found = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        found[str(path.relative_to(folder))] = stat.filemode(status.st_mode)
        if stat.S_ISREG(status.st_mode) and status.st_size < 1 << 28:
            found[str(path.relative_to(folder))] += hashlib.sha256(path.read_bytes()).hexdigest()
    return found
