"""Reads and writes a benchmark's results: one JSON line per trial, readable after any interruption."""

import contextlib
import json
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple, NotRequired, TypedDict

from geort_drake.benchmark.config import ERRORS, check, parse_json
from geort_drake.errors import BenchmarkError, OutputError, UnknownNameError
from geort_drake.files import lock, write_text, writing
from geort_drake.simulation.tasks import find_task

Record = dict[str, Any]


class _Identity(TypedDict):
    method: str
    object: str
    seed: int
    condition: NotRequired[str]


class _Raised(_Identity):
    error: str  # last line of the traceback
    traceback: str  # file in the benchmark's folder


class TrialKey(NamedTuple):
    """Identifies a trial.

    Attributes:
        method: name of a method, or of a replayed session.
        object: a case of the task, such as the object to grasp.
        seed: seed of the scenario.
        condition: name of a changed scenario such as `delay=100`; empty for the scenario itself.
    """

    method: str
    object: str
    seed: int
    condition: str = ""

    @property
    def file_stem(self) -> str:
        """Stem of the trial's own files."""
        return "-".join(str(self).split(" "))

    def __str__(self) -> str:
        """Returns the key as arguments of a command."""
        return " ".join(str(part) for part in self if part != "")


def training_of(name: str) -> tuple[str, int]:
    """Splits a name such as "geort~1" into method and number of the training; 0 without a number."""
    method, _, number = name.partition("~")
    return method, int(number or 0)


def by_training(record: Record) -> Record:
    """Returns a copy of the record with the name of its method and the number of its `training`."""
    method, number = training_of(record["method"])
    return {**record, "method": method, "training": number}


def key_of(record: Record) -> TrialKey:
    """Returns the key of a record."""
    return TrialKey(record["method"], record["object"], record["seed"], record.get("condition", ""))


def identity(key: TrialKey) -> Record:
    """Returns the fields of a record that identify its trial."""
    named = key._asdict()
    return named if key.condition else {name: named[name] for name in ("method", "object", "seed")}


def outcome_line(record: Record) -> str:
    """Describes a trial and its outcome, for a progress display."""
    return f"{key_of(record)}: {'error' if 'error' in record else record['outcome']}"


def check_record(record: Any, where: str) -> None:
    """Checks a record's fields and types, and that they agree on the outcome.

    Raises:
        BenchmarkError: the message begins with `where` and names the field, and expected and given values.
    """
    check(record, _Identity, where)
    if condition := record.get("condition"):
        try:
            valid = math.isfinite(float(condition.partition("=")[2]))
        except ValueError:
            valid = False
        if not valid:
            raise BenchmarkError(f"{where}: condition must be NAME=NUMBER, not '{condition}'")
    if "error" in record:
        check(record, _Raised, where)
        return
    try:
        task = find_task(record.get("task", "grasp"))
    except UnknownNameError as error:
        raise BenchmarkError(f"{where}: {error}") from error
    check(record, task.result, where)
    success, time, longest = record["success"], record["completion_time"], record["simulated_time"]
    given = {name: record[name] for name in ("outcome", "completion_time", "first_attempt")}
    if success:
        consistent = record["outcome"] == "success" and time is not None and 0 <= time <= longest
    else:
        consistent = record["outcome"] != "success" and time is None and not record["first_attempt"]
    if not consistent:
        raise BenchmarkError(f"{where}: success is {success}, which contradicts {given}")


def keep_error(folder: Path, record: Record) -> Record:
    """Returns a record as a benchmark's folder stores it.

    The traceback of a failed trial is written to a file, which the record names. A result that `check_record`
    rejects, such as an infinite force, counts as an error too.
    """
    if "error" not in record:
        try:
            check_record(record, "the simulation's result is invalid")
            return record
        except BenchmarkError as error:
            record = {**identity(key_of(record)), "error": str(error)}
    path = Path(ERRORS) / f"{key_of(record).file_stem}.txt"
    write_text(folder / path, record["error"])
    return {**record, "error": record["error"].strip().splitlines()[-1], "traceback": str(path)}


def read_records(path: str | os.PathLike) -> list[Record]:
    """Reads the last record of each trial in a results file; skips an incomplete last line.

    Raises:
        BenchmarkError: the file is missing, or a line is invalid or repeats a trial that has a result.
    """
    path = Path(path)
    if not path.is_file():
        raise BenchmarkError(f"{path}: no such results file")
    return _parse(path, path.read_bytes().rpartition(b"\n")[0])


class TrialLog:
    """A results file opened for writing by one process; a context manager.

    Opening removes an incomplete last line. A line written by `append` survives a crash of the process or
    machine.

    Attributes:
        path: the file.
        records: last record of each trial when the file was opened.
        torn: whether an incomplete last line was removed.

    Raises:
        OutputError: another process has opened the file.
        BenchmarkError: see `read_records`.
    """

    def __init__(self, path: str | os.PathLike):
        self.path = Path(path)
        with writing(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            # Unbuffered, because a buffer would keep a line that could not be written.
            self._file = open(self.path, "a+b", buffering=0)
        try:
            lock(self._file.fileno(), self.path)
        except OutputError:
            self._file.close()
            raise
        try:
            self._file.seek(0)
            whole, newline, rest = self._file.read().rpartition(b"\n")
            self.records = _parse(self.path, whole)
            self.torn = bool(rest)
            if self.torn:
                self._file.truncate(len(whole) + len(newline))
        except BaseException:
            self.close()
            raise

    def unfinished(self, keys: Iterable[TrialKey]) -> list[TrialKey]:
        """Returns the trials without a result when the file was opened, including trials with an error."""
        finished = {key_of(record) for record in self.records if "error" not in record}
        return [key for key in keys if key not in finished]

    def append(self, record: Record) -> None:
        """Writes a record to the disk; it replaces an earlier error of the trial.

        Raises:
            OutputError: writing failed, for example on a full disk; the next opening removes the partial
                line.
        """
        with writing(self.path):
            line = json.dumps(record, allow_nan=False).encode() + b"\n"
            while line:
                line = line[self._file.write(line) :]
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Releases the file; if nothing was written, removes it and a folder that contains nothing else."""
        with contextlib.suppress(OSError):
            if self.path.stat().st_size == 0 and os.listdir(self.path.parent) == [self.path.name]:
                self.path.unlink()
                self.path.parent.rmdir()
        self._file.close()

    def __enter__(self) -> "TrialLog":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _parse(path: Path, content: bytes) -> list[Record]:
    records: dict[TrialKey, Record] = {}
    for number, line in enumerate(content.splitlines(), start=1):
        where = f"{path}, line {number}"
        try:
            record = parse_json(line, _Identity, "not a trial's result")
            check_record(record, "not a trial's result")
        except BenchmarkError as error:
            raise BenchmarkError(
                f"{where}: {error}; repair or delete the line, or choose another folder"
            ) from error
        key = key_of(record)
        if "error" not in records.get(key, {"error": ""}):
            raise BenchmarkError(f"{where}: a second result of {key}")
        records[key] = record
    return list(records.values())
