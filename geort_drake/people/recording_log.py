"""Saves a recording while it is made: frames are appended to a plain file, which becomes the recording.

The file is `NAME.npz.log` next to `NAME.npz`: a line of JSON with the metadata, then rows of float64: t,
p_HK (63), valid, X_WH (7), joints of a robot.
"""

import json
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from geort_drake.errors import GeortError, OutputError, RecordingError
from geort_drake.files import lock, writing
from geort_drake.people.recording import Recording


class RecordingLog:
    """Appends frames to a file, and turns it into a recording at the end.

    Attributes:
        failed: whether frames could not be written; later ones are dropped.

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
        self._error: OutputError | None = None
        with writing(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._log.open("ab", buffering=0)
            lock(self._file.fileno(), self._log)
            if self._file.tell() > 0:
                raise OutputError(f"{self._log}: an earlier session left this file; move it away")
            self._file.write(json.dumps(metadata).encode() + b"\n")

    @property
    def failed(self) -> bool:
        return self._error is not None

    def append(
        self,
        t: np.ndarray,
        p_HK: np.ndarray,
        valid: np.ndarray,
        X_WH: np.ndarray,
        robot: np.ndarray | None = None,
    ) -> None:
        """Appends frames; shapes and units as in `Recording`, but t may start at any time.

        If writing fails, this warns, later frames are dropped, and `finish` raises the error.
        """
        if self._error is None:
            rows = [
                np.reshape(part, (len(t), -1)) for part in (t, p_HK, valid, X_WH, robot) if part is not None
            ]
            try:
                self._file.write(np.hstack(rows).astype("<f8").tobytes())
            except OSError as error:
                self._error = OutputError(f"{self._log}: cannot be written: {error.strerror}")
                warnings.warn(f"the recording ends here: {self._error}", RuntimeWarning, stacklevel=2)

    def finish(self, metadata: Mapping[str, Any] | None = None) -> bool:
        """Turns the file into the recording; returns False if it has no frames, and so no recording is saved.

        Args:
            metadata: entries to add, such as facts known only at the end.

        Raises:
            OutputError: frames or the recording could not be written. What was written stays in the log.
        """
        try:
            if self._error is not None:
                raise self._error
            return _save(self._log, metadata or {})
        finally:
            self._file.close()  # and with it the lock


def recover(folder: Path) -> None:
    """Turns the logs that killed sessions left in a folder into their recordings, with a warning for each.

    Logs of sessions that go on, those that cannot be read, and those whose recording exists stay.
    """
    for log in sorted(folder.glob("*.npz.log")):
        saved = log.with_suffix("")
        try:
            with writing(log), log.open("rb") as file:
                lock(file.fileno(), log)
                if saved.exists():
                    raise OutputError(f"{log}: {saved.name} exists; move one of them away")
                if _save(log, {}):
                    warnings.warn(
                        f"saved {saved}, the recording of a session that was interrupted", stacklevel=2
                    )
        except GeortError as error:
            warnings.warn(f"not recovered: {error}", stacklevel=2)


def _save(log: Path, metadata: Mapping[str, Any]) -> bool:
    recording = read_log(log)
    if recording is not None:
        recording.metadata.update(metadata)
        recording.save(log.with_suffix(""))
    log.unlink()
    return recording is not None


def read_log(path: Path) -> Recording | None:
    """Returns the frames of a log; None if there are none. A last row that is cut off is left out."""
    head, _, body = path.read_bytes().partition(b"\n")
    try:
        metadata = json.loads(head or b"{}")
        columns = 72 + len(metadata.get("robot_signals", []))
    except (ValueError, AttributeError) as error:
        raise RecordingError(f"{path}: not the log of a recording: {error}") from None
    count = len(body) // (8 * columns)
    if not count:
        return None
    rows = np.frombuffer(body[: 8 * columns * count], "<f8").reshape(count, columns)
    robot = rows[:, 72:] if columns > 72 else None
    p_HK = rows[:, 1:64].reshape(-1, 21, 3)
    return Recording(rows[:, 0] - rows[0, 0], p_HK, rows[:, 64] > 0.5, rows[:, 65:72], metadata, robot)
