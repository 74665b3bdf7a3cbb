"""Saves a recording while it is made: rows are appended to a plain file, which becomes the recording.

The file is `NAME.npz.log` next to `NAME.npz`: a line of JSON with the metadata, then rows of float64: t,
p_HK (63), valid, X_WH (7), joints of a robot.
"""

import json
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from geort_drake.errors import GeortError, OutputError, RecordingError
from geort_drake.files import lock, writing
from geort_drake.people.recording import Recording


class RecordingLog:
    """Appends rows to a file, and turns it into a recording at the end.

    Attributes:
        error: why rows could not be written, or None; later ones are dropped.

    Args:
        path: an .npz file; an earlier one is replaced when the recording is finished.
        metadata: metadata of the recording.

    Raises:
        OutputError: the disk is full, the folder is not writable, or another session's log is in the way.
        RecordingError: the path has another suffix.
    """

    def __init__(self, path: str | os.PathLike, metadata: dict):
        self.path, self._log = Path(path), Path(f"{path}.log")
        if self.path.suffix != ".npz":
            raise RecordingError(f"{path}: a recording is saved as .npz, not '{self.path.suffix}'")
        self.error: OutputError | None = None
        with writing(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._log.open("ab", buffering=0)
            lock(self._file.fileno(), self._log)
            if self._file.tell() > 0:
                raise OutputError(f"{self._log}: an earlier session left this file; move it away")
            self._file.write(json.dumps(metadata).encode() + b"\n")

    def append(self, row: np.ndarray) -> None:
        """Appends a row; t may start at any time. If that fails, it warns, and `finish` raises the error."""
        if self.error is None:
            try:
                self._file.write(row.astype("<f8").tobytes())
            except OSError as error:
                self.error = OutputError(f"{self._log}: cannot be written: {error.strerror}")
                warnings.warn(f"the recording ends here: {self.error}", RuntimeWarning, stacklevel=2)

    def finish(self, **metadata: Any) -> bool:
        """Turns the file into the recording; returns False if it has no rows, and so no recording is saved.

        Args:
            metadata: entries to add, such as facts known only at the end.

        Raises:
            OutputError: rows or the recording could not be written. What was written stays in the log.
        """
        try:
            if self.error is not None:
                raise self.error
            return _save(self._log, **metadata)
        finally:
            self._file.close()  # and with it the lock


def recover(folder: Path) -> None:
    """Turns the logs that killed sessions left in a folder into their recordings, with a warning for each.

    Logs of sessions that go on, those that cannot be read, and those whose recording exists stay.
    """
    for log in sorted(folder.glob("*.npz.log")):
        recording = log.with_suffix("")
        try:
            with writing(log), log.open("rb") as file:
                lock(file.fileno(), log)
                if recording.exists():
                    raise OutputError(f"{recording.name} exists; move one of them away")
                if _save(log):
                    what = f"saved {recording}, the recording of a session that was interrupted"
                    warnings.warn(what, stacklevel=2)
        except (GeortError, ValueError) as error:
            warnings.warn(f"{log}: not recovered: {error}", stacklevel=2)


def _save(log: Path, **metadata: Any) -> bool:
    head, _, body = log.read_bytes().partition(b"\n")
    metadata = {**json.loads(head or b"{}"), **metadata}
    columns = 72 + len(metadata.get("robot_signals", []))
    count = len(body) // (8 * columns)  # a last row that is cut off is left out
    if count:
        rows = np.frombuffer(body, "<f8", count * columns).reshape(count, columns)
        recording_of_rows(rows, metadata).save(log.with_suffix(""))
    log.unlink()
    return count > 0


def recording_of_rows(rows: np.ndarray, metadata: dict[str, Any]) -> Recording:
    """Returns a recording that begins at zero."""
    t, p_HK, valid, X_WH, robot = np.split(rows, [1, 64, 65, 72], axis=1)
    joints = robot if robot.size else None
    return Recording(t[:, 0] - t[0], p_HK.reshape(-1, 21, 3), valid[:, 0] > 0.5, X_WH, metadata, joints)
