"""Saves a recording while it is made: frames are appended to a plain file, which becomes the recording.

The file is `NAME.npz.log` next to `NAME.npz`: a line of JSON with the metadata and the row's length, then
rows of float64: t, p_HK (63), valid, X_WH (7), joints of a robot. After a crash, the next session that
records to the same name turns it into a recording of its own.
"""

import json
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from geort_drake.errors import OutputError, RecordingError
from geort_drake.files import writing
from geort_drake.people.recording import Recording


class RecordingLog:
    """Appends frames to a file, and turns it into a recording at the end.

    Attributes:
        recovered: the file into which an interrupted session's frames were saved, or None.
        failed: whether frames could not be written; later ones are dropped.

    Args:
        path: an .npz file; an earlier one is replaced when the recording is finished.
        metadata: metadata of the recording.

    Raises:
        OutputError: the disk is full, or the folder is not writable.
        RecordingError: the path has another suffix, or an interrupted session's file cannot be read.
    """

    def __init__(self, path: str | os.PathLike, metadata: dict):
        self.path, self._log = Path(path), Path(f"{path}.log")
        if self.path.suffix != ".npz":
            raise RecordingError(f"{path}: a recording is saved as .npz, not '{self.path.suffix}'")
        self.recovered: Path | None = None
        self._error: OutputError | None = None
        with writing(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if self._log.exists() and (recording := read_log(self._log)) is not None:
                names = (
                    self.path.with_name(f"{self.path.stem}-interrupted-{n}.npz") for n in range(1, 10**6)
                )
                self.recovered = next(name for name in names if not name.exists())
                recording.save(self.recovered)
            self._file = self._log.open("wb", buffering=0)
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
        self._file.close()
        if self._error is not None:
            raise self._error
        if (recording := read_log(self._log)) is not None:
            recording.metadata.update(metadata or {})
            recording.save(self.path)
        self._log.unlink()
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
