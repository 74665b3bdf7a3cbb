"""The recorder: a system that samples a plant and further ports, for a Rerun file and for viewers.

Samples are kept in memory and written once, as columns, which takes far less time and space than logging
each body as it moves.
"""

import atexit
import functools
import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun.blueprint as rrb
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    Context,
    EventStatus,
    InputPortIndex,
    LeafSystem,
    OutputPort,
    PortDataType,
)

from geort_drake.rerun.layout import Layout
from geort_drake.rerun.streams import LiveSink, Property, file_writer, live_writer
from geort_drake.rerun.track import Track
from geort_drake.rerun.writer import Writer

_BATCH_S = 0.1  # wall time between two batches for viewers
_READ_AT_ONCE = 64  # samples


class RerunRecorder(LeafSystem):
    """Records a plant and other ports to a Rerun file, to viewers, or to both.

    Use `add_rerun_recorder` to make and connect it. Samples are taken in publish events, periodic and forced.
    If time goes back, the samples after that time are dropped. Viewers get the samples in batches. The file
    is written atomically by `flush`, by `close`, when the recorder is left as a context manager, also after
    an error, and at the latest when the process ends.

    Input ports (one that is needed twice is declared once):
        body_poses (abstract list of RigidTransform): X_WB of all bodies, in plant order.
        contact_results (abstract ContactResults): if contact is recorded.
        <signal key> (n): any vector; <signal key>/0, 1, ... for a signal of several ports.
        <state key> (1): integer code.
        <hand key>/keypoints (63): p_HK, keypoint-major, m.
        <hand key>/wrist_pose (abstract RigidTransform): X_OH.
        <hand key>/valid (1): 1 tracked, 0 lost; if the hand has such a port.
        <points key> (3k): p_FP, point-major, m.
        <camera key>/color_image (abstract ImageRgba8U).
        <camera key>/body_pose (abstract RigidTransform): X_WB of the camera's body.

    Attributes:
        path: where the file is written; None if there are only viewers.
    """

    def __init__(
        self,
        path: Path | None,
        tracks: Sequence[Track],
        sources: Mapping[str, OutputPort],
        period: float,
        *,
        layout: Layout,
        sinks: Sequence[LiveSink],
        application_id: str,
        properties: Mapping[str, Property],
        blueprint: rrb.Blueprint | None,
    ):
        super().__init__()
        self.path = path
        self._tracks = list(tracks)
        self._layout, self._blueprint = layout, blueprint
        self._sinks = list(sinks)
        self._application_id, self._properties = application_id, dict(properties)
        self._times: list[float] = []  # of the samples, s, increasing
        self._unread: list[Sequence[tuple | None]] = []  # the newest samples, which have no rows yet
        self._live: Writer | None = None
        self._sent = 0  # number of samples sent to the viewers
        self._sent_at = 0.0  # wall time, s
        self._changed = True  # since the file was written
        self._closed = False
        # For each port, a function that copies its value.
        self._copies: dict[str, Callable[[Context], Any]] = {}
        for name, source in sources.items():
            if source.get_data_type() == PortDataType.kVectorValued:
                self._copies[name] = self.DeclareVectorInputPort(name, source.size()).Eval
            else:
                index = self.DeclareAbstractInputPort(name, source.Allocate()).get_index()
                self._copies[name] = functools.partial(self._clone, index)
        self.DeclarePeriodicPublishEvent(period, 0.0, self._sample)
        self.DeclareForcedPublishEvent(self._sample)
        # Registered after Rerun's own handler, and therefore run before Rerun shuts down.
        atexit.register(self.close)

    @property
    def times(self) -> np.ndarray:
        """Times (T,) of the samples that are kept, s; without a file, of those not yet sent to viewers."""
        return np.array(self._times)

    def set_properties(self, properties: Mapping[str, Property]) -> None:
        """Adds properties to the file, such as an outcome that is known only at the end."""
        self._properties.update(properties)
        self._changed = True

    def flush(self) -> None:
        """Writes the file with all samples so far, and sends viewers the remaining ones."""
        if self._closed:
            return
        if self._sinks and self._sent < len(self._times):
            self._send()
        if self.path is None or not self._changed:
            return
        self._read()
        with file_writer(
            self.path,
            application_id=self._application_id,
            recording_id=self._digest(),
            blueprint=self._blueprint or self._layout.blueprint(self._tracks),
            properties=self._properties,
        ) as writer:
            self._write(writer, 0)
        self._changed = False

    def close(self) -> None:
        """Flushes; later samples are not kept, and closing again does nothing."""
        if self._closed:
            return
        self.flush()
        self._closed = True
        atexit.unregister(self.close)
        if self._live is not None:
            self._live.close()
        # Drake keeps this system until the process ends.
        self._tracks.clear()

    def __enter__(self) -> "RerunRecorder":
        return self

    def __exit__(self, *_exception: object) -> None:
        self.close()

    def _sample(self, context: Context) -> EventStatus:
        if self._closed:
            return EventStatus.DidNothing()
        now = context.get_time()
        self._go_back(now)
        copies: dict[str, Any] = {}
        sample: list[tuple | None] = []
        large = False
        for track in self._tracks:
            if not track.due(now):
                sample.append(None)
                continue
            for name in track.inputs:
                if name not in copies:
                    copies[name] = self._copies[name](context)
            sample.append(tuple(copies[name] for name in track.inputs))
            large = large or track.spec.large
        self._times.append(now)
        self._unread.append(sample)
        self._changed = True
        if large or len(self._unread) == _READ_AT_ONCE:
            self._read()
        if self._sinks and time.monotonic() >= self._sent_at + _BATCH_S:
            self._send()
        return EventStatus.Succeeded()

    def _clone(self, index: InputPortIndex, context: Context) -> AbstractValue:
        return self.EvalAbstractInput(context, index).Clone()

    def _go_back(self, now: float) -> None:
        """Drops the samples at and after a time, s."""
        keep = len(self._times)
        while keep and self._times[keep - 1] >= now:
            keep -= 1
        if keep < len(self._times):
            self._read()
            del self._times[keep:]
            for track in self._tracks:
                del track.rows[keep:]
            self._sent = min(self._sent, keep)

    def _read(self) -> None:
        """Makes rows of the unread samples; a batch takes a third less time than one sample after another."""
        columns = [
            [None if values is None else track.spec.read(*map(_content, values)) for values in column]
            for track, *column in zip(self._tracks, *self._unread, strict=True)
        ]
        # Only now, so that the tracks stay equally long when the process is interrupted.
        self._unread.clear()
        for track, rows in zip(self._tracks, columns, strict=True):
            track.rows += rows

    def _send(self) -> None:
        """Sends new samples to the viewers; without a file, drops them afterwards."""
        self._read()
        if self._live is None:
            self._live = live_writer(
                self._sinks,
                application_id=self._application_id,
                blueprint=self._blueprint or self._layout.blueprint(self._tracks),
                name=self.path.stem if self.path else "live",
                properties=self._properties,
            )
        self._write(self._live, self._sent)
        self._sent, self._sent_at = len(self._times), time.monotonic()
        if self.path is None:
            self._times.clear()
            for track in self._tracks:
                track.rows.clear()
            self._sent = 0

    def _write(self, writer: Writer, first: int) -> None:
        self._layout.scene.write(writer)
        writer.at(np.array(self._times[first:]))
        for track in self._tracks:
            track.spec.write(writer, track.key, track.rows[first:])

    def _digest(self) -> str:
        """A hash of the contents: equal simulations give equal recordings."""
        digest = hashlib.sha256(repr(sorted(self._properties.items())).encode())
        digest.update(np.array(self._times).tobytes())
        for track in self._tracks:
            digest.update(repr(track.inputs).encode())
            for row in track.rows:
                for part in row if isinstance(row, tuple) else (row,):
                    digest.update(part if isinstance(part, bytes) else np.asarray(part, float).tobytes())
        return digest.hexdigest()[:32]


def _content(copy: np.ndarray | AbstractValue) -> Any:
    return copy.get_value() if isinstance(copy, AbstractValue) else copy
