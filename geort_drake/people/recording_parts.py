"""Saves a recording while it is made: numbered parts in a folder next to its file, joined at the end.

After a crash or on a full disk, the written parts stay. `read_recording` reads them under the name of the
missing file or of the folder. The next session that records to the same file first joins them into a file of
their own.
"""

import os
import queue
import shutil
import tempfile
import threading
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from geort_drake.errors import OutputError, RecordingError
from geort_drake.files import writing
from geort_drake.people.recording import Recording

_SUFFIX = ".parts"
_MAX_WAITING = 8  # length of the queue of parts to write


class RecordingParts:
    """Writes parts of a recording to disk in a thread, and joins them at the end.

    Attributes:
        recovered: the file into which an interrupted session's parts were joined, or None.

    Args:
        path: an .npz file; an earlier one is replaced when the recording is finished.
        metadata: metadata of the recording.

    Raises:
        OutputError: the disk is full, or the folder is not writable.
        RecordingError: the path has another suffix, or an interrupted session's parts cannot be read.
    """

    def __init__(self, path: str | os.PathLike, metadata: dict):
        self.path, self._metadata = Path(path), dict(metadata)
        if self.path.suffix != ".npz":
            raise RecordingError(f"{path}: a recording is saved as .npz, not '{self.path.suffix}'")
        self._folder = _folder_of(self.path)
        self.recovered = _recover(self.path)
        with writing(self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)
        self._count = 0
        self._error: OutputError | None = None
        self._waiting: queue.Queue[Recording | None] = queue.Queue(_MAX_WAITING)
        self._thread = threading.Thread(target=self._write, name="recording", daemon=True)
        self._thread.start()

    @property
    def failed(self) -> bool:
        """Whether a part could not be written; later parts are dropped."""
        return self._error is not None

    def append(
        self,
        t: np.ndarray,
        p_HK: np.ndarray,
        valid: np.ndarray,
        X_WH: np.ndarray,
        robot: np.ndarray | None = None,
    ) -> None:
        """Queues a part without waiting; shapes and units as in `Recording`, but t may start at any time.

        If writing fails or is too slow, parts are dropped: this warns at once, and `finish` raises the error.
        """
        if self._error is None:
            try:
                self._waiting.put_nowait(Recording(t, p_HK, valid, X_WH, self._metadata, robot))
            except queue.Full:
                self._fail(OutputError(f"{self._folder}: cannot be written: the disk is too slow"))

    def finish(self, metadata: Mapping[str, Any] | None = None) -> bool:
        """Joins the parts into the file and removes them; returns False if there are none, and so no file.

        Args:
            metadata: entries to add, such as facts known only at the end.

        Raises:
            OutputError: a part or the file could not be written. Written parts stay.
        """
        self._waiting.put(None)
        self._thread.join()
        if self._error is not None:
            if not self._count:
                shutil.rmtree(self._folder, ignore_errors=True)
            raise self._error
        recording = read_parts(self._folder)
        if recording is not None:
            recording.metadata.update(metadata or {})
            recording.save(self.path)
        _remove(self._folder)
        return recording is not None

    def _write(self) -> None:
        while (part := self._waiting.get()) is not None:
            if self._error is None:
                try:
                    part.save(self._folder / f"{self._count:06d}.npz")
                    self._count += 1
                except OSError as error:
                    self._fail(error if isinstance(error, OutputError) else OutputError(str(error)))

    def _fail(self, error: OutputError) -> None:
        self._error = error
        warnings.warn(f"the recording ends here: {error}", RuntimeWarning, stacklevel=2)


def read_parts(path: str | os.PathLike) -> Recording | None:
    """Joins the parts of an unfinished recording; returns None if there are none, or `path` is finished.

    Args:
        path: path of the recording, or of the folder of its parts.

    Raises:
        RecordingError: a part is no recording.
    """
    path = Path(path)
    folder = path if path.suffix == _SUFFIX else _folder_of(path)
    if path != folder and path.exists():
        return None
    parts = [Recording.load(part) for part in sorted(folder.glob("[0-9]*.npz"))]
    if not parts:
        return None
    t, p_HK, valid = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("t", "p_HK", "valid")
    )
    X_WH = np.concatenate([part.X_WH for part in parts if part.X_WH is not None])
    robots = [part.robot for part in parts if part.robot is not None]
    robot = np.concatenate(robots) if robots else None
    return Recording(t - t[:1], p_HK, valid, X_WH, parts[0].metadata, robot)


def _recover(path: Path) -> Path | None:
    """Joins an interrupted session's parts into a file of their own; returns its path, or None."""
    folder = _folder_of(path)
    if (recording := read_parts(folder)) is None:
        return None
    recovered = None
    # A session that was killed between the two steps of `finish` has already written its file.
    if not (path.is_file() and Recording.load(path).digest == recording.digest):
        names = (path.with_name(f"{path.stem}-interrupted-{number}.npz") for number in range(1, 1_000_000))
        recovered = next(name for name in names if not name.exists())
        recording.save(recovered)
    _remove(folder)
    return recovered


def _folder_of(path: Path) -> Path:
    return path.parent / (path.name + _SUFFIX)  # works for ".", which has no name


def _remove(folder: Path) -> None:
    """Removes a folder atomically, by renaming it first."""
    with writing(folder):
        aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}-old-", dir=folder.parent))
        os.replace(folder, aside)
        shutil.rmtree(aside)
