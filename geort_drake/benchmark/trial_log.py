"""The results file of a benchmark: one JSON line per trial, whole after an interruption at any time."""

import fcntl
import json
import math
import os
from pathlib import Path
from typing import Any, NamedTuple, NotRequired, TypedDict

from geort_drake.benchmark.json_types import require_type
from geort_drake.errors import BenchmarkError
from geort_drake.files import writing
from geort_drake.simulation.trial import TrialResult


class _Identity(TypedDict):
    method: str
    object: str
    seed: int
    condition: NotRequired[str]


class _Raised(_Identity):
    """The line of a trial that raised."""

    # Last line of the traceback, and the file, within the folder, that has all of it.
    error: str
    traceback: str


class TrialKey(NamedTuple):
    """What a trial is known by."""

    method: str
    object: str
    seed: int
    # Name of a changed scenario; empty for the scenario as it is.
    condition: str = ""

    @property
    def file_stem(self) -> str:
        """What the trial's own files are called, without folder and suffix."""
        return "-".join(str(part) for part in self if part != "")

    @property
    def words(self) -> str:
        """As a command line names it."""
        return " ".join(str(part) for part in self if part != "")

    def __str__(self) -> str:
        parts = [self.method, self.object, f"seed {self.seed}", self.condition]
        return ", ".join(part for part in parts if part)


def key_of(record: dict) -> TrialKey:
    """The key of a line."""
    return TrialKey(record["method"], record["object"], record["seed"], record.get("condition", ""))


def outcome_line(record: dict) -> str:
    """The trial of a line and how it ended, for a progress display."""
    return f"{key_of(record)}: {'error' if 'error' in record else record['outcome']}"


def identity(key: TrialKey) -> dict:
    """The fields of a line that say which trial it is."""
    named = key._asdict()
    return named if key.condition else {name: named[name] for name in ("method", "object", "seed")}


def check_record(record: Any, where: str) -> None:
    """Checks that a line is a trial's: fields, their types, and that they agree on how it ended.

    Args:
        record: the line.
        where: what the message begins with.

    Raises:
        BenchmarkError: it is not; with the field, and what was wanted and given.
    """
    require_type(record, _Identity, where)
    if condition := record.get("condition"):
        try:
            sound = math.isfinite(float(condition.partition("=")[2]))
        except ValueError:
            sound = False
        if not sound:
            raise BenchmarkError(f"{where}: condition must be NAME=NUMBER, not '{condition}'")
    if "error" in record:
        require_type(record, _Raised, where)
        return
    require_type(record, TrialResult, where)
    success, ended = record["success"], "success" if record["success"] else "no success"
    time, longest = record["completion_time"], record["simulated_time"]
    if (record["outcome"] == "success") != success:
        raise BenchmarkError(f"{where}: a trial with {ended} cannot have the outcome '{record['outcome']}'")
    if (time is not None) != success or (success and not 0 <= time <= longest):
        wanted = f"between 0 and its simulated_time, {longest}" if success else "null"
        raise BenchmarkError(
            f"{where}: the completion_time of a trial with {ended} must be {wanted}, not {time}"
        )
    if record["first_attempt"] and not success:
        raise BenchmarkError(f"{where}: first_attempt must not be true of a trial with {ended}")


def read_records(path: str | os.PathLike) -> list[dict]:
    """The last line of each trial of a results file; one that was being written at the end is left out.

    Raises:
        BenchmarkError: the file does not exist, or a line of it is not a trial's, or follows its result.
    """
    path = Path(path)
    if not path.is_file():
        raise BenchmarkError(f"{path}: there is no such results file")
    return _parse(path, path.read_bytes().rpartition(b"\n")[0])


class TrialLog:
    """A results file opened for writing by this process alone; use as a context manager.

    Opening drops a torn last line from the file. Every line that `append` has written survives the end of
    the process and of the machine.

    Attributes:
        path: of the file.
        records: the last line of each trial that was in the file when it was opened.
        torn: whether a torn last line was dropped.

    Raises:
        BenchmarkError: another process has the file open, or see `read_records`.
    """

    def __init__(self, path: str | os.PathLike):
        self.path = Path(path)
        with writing(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            # Without a buffer, which would still hold a line that could not be written.
            self._file = open(self.path, "a+b", buffering=0)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._file.close()
            raise BenchmarkError(f"{self.path}: another process is writing to this file") from error
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

    @property
    def finished(self) -> set[TrialKey]:
        """Trials of `records` that have a result; those that raised are to be tried again."""
        return {key_of(record) for record in self.records if "error" not in record}

    def append(self, record: dict) -> None:
        """Writes a trial's line to the disk, in the place of an earlier one that says it raised.

        Raises:
            OutputError: the disk is full, say; what was written of the line is dropped at the next opening.
        """
        with writing(self.path):
            line = json.dumps(record, allow_nan=False).encode() + b"\n"
            while line:
                line = line[self._file.write(line) :]
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Gives the file free."""
        self._file.close()

    def __enter__(self) -> "TrialLog":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _parse(path: Path, content: bytes) -> list[dict]:
    records: dict[TrialKey, dict] = {}
    for number, line in enumerate(content.splitlines(), start=1):
        where = f"{path}, line {number}"
        try:
            record = json.loads(line)
            check_record(record, "not a trial's result")
        except (ValueError, RecursionError, BenchmarkError) as error:
            said = error if isinstance(error, BenchmarkError) else f"not a trial's result: {error}"
            raise BenchmarkError(
                f"{where}: {said}; mend or delete the line, or choose another folder"
            ) from error
        key = key_of(record)
        if "error" not in records.get(key, {"error": ""}):
            raise BenchmarkError(f"{where}: a second result of {key}")
        records[key] = record
    return list(records.values())
