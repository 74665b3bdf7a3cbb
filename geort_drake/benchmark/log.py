"""The log of a benchmark, `trials.jsonl`: one JSON line per finished trial, whatever interrupts the run."""

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from geort_drake.console import warn
from geort_drake.errors import BenchmarkError
from geort_drake.files import finite_json, lock, writing

TRIALS = "trials.jsonl"
RESULT = ("success", "score", "completion_time", "timeout", "outcome")  # fields of a row without an error
Row = dict[str, Any]


class TrialKey(NamedTuple):
    """Identifies a trial; each attribute is a field of its row.

    Attributes:
        method: name of the method.
        training: number of the method's training, from 0.
        task, kind: names of the task and of the kind of simulated person.
        condition: the changed field of the scenario and its value, such as "operator.visual_delay=0.3"; empty
            for the scenario itself.
        object: case of the task, such as the object to grasp.
        person: number of the person, see `Scenario.person`.
        seed: seed of the scenario.
    """

    method: str
    training: int
    task: str
    kind: str
    condition: str
    object: str
    person: int
    seed: int

    def __str__(self) -> str:
        method = f"{self.method}~{self.training}" if self.training else self.method
        parts = [method, self.task, self.kind, self.condition, self.object, f"person {self.person}"]
        return ", ".join([*filter(None, parts), f"seed {self.seed}"])


def key_of(row: Row) -> TrialKey:
    """Returns the key of a row; raises KeyError if a field is missing."""
    return TrialKey(*(row[name] for name in TrialKey._fields))


def read_rows(path: str | os.PathLike) -> list[Row]:
    """Reads the last row of each trial; skips damaged lines and warns of them.

    Raises:
        BenchmarkError: the file is missing.
    """
    path = Path(path)
    if not path.is_file():
        raise BenchmarkError(f"{path}: no such file; is {path.parent} the folder of a benchmark?")
    rows: dict[TrialKey, Row] = {}
    for number, line in enumerate(path.read_bytes().splitlines(), start=1):
        row = _parse(line)
        if row is None:
            warn(f"{path}, line {number}: not the row of a trial; skipped, the trial will be repeated")
        else:
            rows[key_of(row)] = row
    return list(rows.values())


def _parse(line: bytes) -> Row | None:
    """Returns the row in a line, with a key and either a result or an error; None if there is none."""
    try:
        row = json.loads(line)
        hash(key_of(row))
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return row if "error" in row or row.keys() >= set(RESULT) else None


class TrialLog:
    """The log, opened for appending by one process; a context manager.

    Opening removes an incomplete last line, which a crash has left.

    Attributes:
        path: the file.
        rows: last row of each trial when the log was opened.

    Raises:
        OutputError: another process has opened the log, or it cannot be written.
    """

    def __init__(self, folder: Path):
        self.path = folder / TRIALS
        with writing(self.path):
            folder.mkdir(parents=True, exist_ok=True)
            self._file = open(self.path, "ab", buffering=0)
        try:
            lock(self._file.fileno(), self.path)
            self.rows = read_rows(self.path)
            whole, newline, rest = self.path.read_bytes().rpartition(b"\n")
            if rest and _parse(rest) is None:
                self._file.truncate(len(whole) + len(newline))
            elif rest:
                self._file.write(b"\n")
        except BaseException:
            self._file.close()
            raise

    def unfinished(self, keys: Iterable[TrialKey]) -> list[TrialKey]:
        """Returns the trials without a result when the log was opened; those with an error are unfinished."""
        finished = {key_of(row) for row in self.rows if "error" not in row}
        return [key for key in keys if key not in finished]

    def append(self, row: Row) -> None:
        """Writes a row to the disk, where it survives a crash of the process or the machine.

        Raises:
            OutputError: writing failed, for example because the disk is full.
        """
        with writing(self.path):
            self._file.write(json.dumps(finite_json(row), allow_nan=False).encode() + b"\n")
            os.fsync(self._file.fileno())

    def __enter__(self) -> "TrialLog":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
