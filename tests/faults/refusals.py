"""Malformed inputs, and whether the program refuses them as it should."""

import dataclasses as dc
import hashlib
import re
import stat
from collections.abc import Callable
from pathlib import Path

from faults.child import run
from geort_drake.cli import run_command

CODE = 2


@dc.dataclass(frozen=True)
class Case:
    """An input that must be refused.

    Attributes:
        kind: what is malformed: recording, checkpoint, ...
        name: how.
        make: writes the input into a folder and gives the command and its arguments, or a function of a
            module and its arguments.
        error: name of the class of the error, or several with | between them.
        says: what the message must match.
    """

    kind: str
    name: str
    make: Callable[[Path], tuple]
    error: str
    says: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.name}"


def faults_of(case: Case, folder: Path) -> list[str]:
    """What is wrong with the refusal of a case, run in an empty folder; nothing, where it is right.

    The named error, exit code 2, the message without a traceback, an end in time and within the memory, and
    nothing written beside what was there.
    """
    room = folder / "room"
    room.mkdir(parents=True)
    command, *arguments = case.make(room)
    before = contents(folder / "room")
    if isinstance(command, str):
        ending = run(run_command, (command, [str(word) for word in arguments]), room, folder / "beside")
    else:
        ending = run(command, tuple(arguments), room, folder / "beside")
    wrong = []
    if ending.code is None:
        wrong.append(f"hung for {ending.seconds:.0f} s")
    elif ending.code != CODE:
        wrong.append(f"exit code {ending.code}")
    if not re.fullmatch(case.error, ending.error):
        wrong.append(f"error {ending.error or 'none'}, not {case.error}")
    if not re.search(case.says, ending.said, re.DOTALL):
        wrong.append(f"does not say {case.says!r}")
    if "Traceback" in ending.said:
        wrong.append("a traceback")
    if contents(folder / "room") != before:
        wrong.append("something was written")
    return [*wrong, ending.said[-2000:]] if wrong else []


def contents(folder: Path) -> dict[str, str]:
    """Every path below a folder with the digest of a file's contents, or what it is instead."""
    found = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        told = stat.filemode(status.st_mode)
        if stat.S_ISREG(status.st_mode) and status.st_size < 1 << 28:
            told += hashlib.sha256(path.read_bytes()).hexdigest()
        found[str(path.relative_to(folder))] = told
    return found
