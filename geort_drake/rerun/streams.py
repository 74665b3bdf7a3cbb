"""Opens Rerun streams to a file, written atomically, and to viewers."""

import contextlib
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from geort_drake.files import atomic_path
from geort_drake.rerun.writer import TIMELINE, Writer

_APPLICATION = "geort_drake"  # recordings of one application share a layout in the viewer
Property = str | int | float | bool
# A listening viewer, or a server to which viewers connect.
Viewer = rr.GrpcSink | rr.GrpcServerSink


@contextlib.contextmanager
def file_writer(
    path: str | os.PathLike,
    *,
    name: str = "",
    application_id: str = _APPLICATION,
    recording_id: str | None = None,
    blueprint: rrb.Blueprint | None = None,
    properties: Mapping[str, Property] | None = None,
    timeline: str = TIMELINE,
) -> Iterator[Writer]:
    """Opens a `Writer` to an .rrd file, which appears when the block ends without an error.

    The data stay in memory until then. Equal data give equal columns; log times are left out. With the
    environment variable RERUN=off no file is written, and a warning says so.

    Args:
        name: name of the recording in the viewer; by default that of the file.

    Raises:
        OutputError: the disk is full, or the folder is not writable.
    """
    path = Path(path)
    stream = _stream(application_id, recording_id)
    if not rr.is_enabled(stream):
        warnings.warn(f"{path}: not written, because of the environment variable RERUN=off", stacklevel=4)
        yield Writer(stream, timeline)
        return
    # Rerun's own writer to files may hang on a full disk, and reports errors on stderr only.
    recording = stream.memory_recording()
    try:
        if blueprint is not None:
            stream.send_blueprint(blueprint, make_active=False)
        _send_properties(stream, name or path.stem, properties or {})
        yield Writer(stream, timeline)
        with atomic_path(path) as draft:
            draft.write_bytes(recording.drain_as_bytes())
    finally:
        stream.disconnect()


def live_writer(
    viewers: Sequence[Viewer],
    *,
    blueprint: rrb.Blueprint,
    name: str,
    properties: Mapping[str, Property],
) -> Writer:
    """Opens a writer that sends data to viewers."""
    stream = _stream(_APPLICATION, None)
    stream.set_sinks(*viewers, default_blueprint=blueprint)
    _send_properties(stream, name, properties)
    return Writer(stream)


def _stream(application_id: str, recording_id: str | None) -> rr.RecordingStream:
    stream = rr.RecordingStream(application_id, recording_id=recording_id, send_properties=False)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    return stream


def _send_properties(stream: rr.RecordingStream, name: str, properties: Mapping[str, Property]) -> None:
    stream.send_recording_name(name)
    if properties:
        # Arrays have explicit types, because Rerun keeps the first type of each name in a process.
        stream.send_property(
            "run", rr.AnyValues(**{key: pa.array([value]) for key, value in properties.items()})
        )
