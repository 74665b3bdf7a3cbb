"""Where columns of data go: a Rerun file that is whole or absent, and viewers that look on."""

import contextlib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from geort_drake.errors import OutputError
from geort_drake.files import atomic_path

TIMELINE = "sim_time"  # s
STEPS = "step"  # of a training
FLUSH_TIMEOUT = 5.0  # s; a viewer that went away must not hold up whoever simulates
Property = str | int | float | bool
LiveSink = rr.GrpcSink | rr.GrpcServerSink


class Writer:
    """Sends arrays to one recording stream, and fails instead of dropping what is malformed.

    Attributes:
        memory: what the writers of columns remember from one batch to the next.
        times: (T,) of the rows to come: s, or steps.
    """

    def __init__(self, stream: rr.RecordingStream, timeline: str = TIMELINE):
        self.memory: dict[str, Any] = {}
        self._stream = stream
        self._timeline = timeline
        self.at(np.empty(0))

    def at(self, times: np.ndarray) -> "Writer":
        """Sets the times (T,) of the rows that follow: s as floats, or steps as integers."""
        self.times = np.asarray(times)
        self._all_times = self._column(self.times)
        return self

    def static(self, path: str, archetype: rr.AsComponents) -> None:
        """Sends what holds at all times."""
        self._stream.log(path, archetype, static=True, strict=True)

    def columns(self, path: str, columns: rr.ComponentColumnList, rows: np.ndarray | None = None) -> None:
        """Sends one entry per time, or one per time of which the mask or indices `rows` hold."""
        index = self._all_times if rows is None else self._column(self.times[rows])
        if len(index.as_arrow_array()):
            self._stream.send_columns(path, [index], columns, strict=True)

    def _column(self, times: np.ndarray) -> rr.TimeColumn:
        kind = "sequence" if np.issubdtype(times.dtype, np.integer) else "duration"
        return rr.TimeColumn(self._timeline, **{kind: times})


# At the end of every whole file.
_FOOTER, _FOOTER_BYTES = b"RRF2FOOT", 12


@contextlib.contextmanager
def file_writer(
    path: Path,
    *,
    application_id: str,
    recording_id: str,
    blueprint: rrb.Blueprint,
    properties: Mapping[str, Property],
    timeline: str = TIMELINE,
) -> Iterator[Writer | None]:
    """Yields the writer of a file, which appears when the block is left without an error.

    Equal data give equal columns, without log times and the properties that Rerun adds; ids of rows differ.
    Yields None, with a warning, where the environment says RERUN=off.

    Raises:
        OutputError: the disk is full, or the place may not be written to.
    """
    stream = rr.RecordingStream(application_id, recording_id=recording_id, send_properties=False)
    if not rr.is_enabled(stream):
        warnings.warn(f"{path}: not written, as the environment says RERUN=off", stacklevel=4)
        yield None
        return
    with atomic_path(path) as draft:
        try:
            stream.set_log_time_enabled(False)
            stream.set_log_tick_enabled(False)
            stream.save(draft, default_blueprint=blueprint)
            _send_properties(stream, path.stem, properties)
            yield Writer(stream, timeline)
        finally:
            stream.disconnect()
        # What Rerun could not write it says on stderr alone.
        with draft.open("rb") as file:
            file.seek(max(0, draft.stat().st_size - _FOOTER_BYTES))
            whole = _FOOTER in file.read()
        if not whole:
            raise OutputError(f"{path}: cannot be written to its end: is the disk full?")


class LiveWriter(Writer):
    """A writer to viewers that are open while the data come in."""

    def __init__(
        self,
        sinks: Sequence[LiveSink],
        *,
        application_id: str,
        recording_id: str | None,
        blueprint: rrb.Blueprint,
        name: str,
        properties: Mapping[str, Property],
    ):
        super().__init__(rr.RecordingStream(application_id, recording_id=recording_id, send_properties=False))
        self._stream.set_log_time_enabled(False)
        self._stream.set_log_tick_enabled(False)
        self._stream.set_sinks(*sinks, default_blueprint=blueprint)
        _send_properties(self._stream, name, properties)

    def disconnect(self) -> None:
        """Sends what is on its way, or gives it up after a while, and says good-bye."""
        try:
            self._stream.flush(timeout_sec=FLUSH_TIMEOUT)
        except (RuntimeError, ValueError) as error:
            warnings.warn(f"the viewer did not get everything: {error}", stacklevel=4)
        self._stream.disconnect()


def is_live(target: object) -> bool:
    """Whether this is a viewer or its address rather than a file."""
    return isinstance(target, LiveSink) or (
        isinstance(target, str) and target.startswith(("rerun://", "rerun+http://", "rerun+https://"))
    )


def live_sink(target: str | LiveSink) -> LiveSink:
    """A sink for an address; one that is a sink already is returned."""
    return rr.GrpcSink(target) if isinstance(target, str) else target


def _send_properties(stream: rr.RecordingStream, name: str, properties: Mapping[str, Property]) -> None:
    stream.send_recording_name(name)
    if properties:
        # Typed arrays, because Rerun keeps the first type it sees under a name for good.
        typed = {key: pa.array([value]) for key, value in properties.items()}
        stream.send_property("run", rr.AnyValues(**typed))
