"""The recorder: a system that samples a plant and other ports, for a Rerun file and for viewers.

Samples are kept in memory and written once as columns, which takes far less time and space than logging each
body as it moves.
"""

import atexit
import hashlib
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, EventStatus, OutputPort, PortDataType

from geort_drake.errors import OutputError
from geort_drake.rerun.layout import Layout
from geort_drake.rerun.specs import Spec
from geort_drake.rerun.streams import Property, Viewer, file_writer, live_writer
from geort_drake.rerun.writer import Writer
from geort_drake.systems.python_system import PythonSystem

_BATCH_S = 0.1  # wall time between two batches for viewers


class RerunRecorder(PythonSystem):
    """Records a plant and other ports to a Rerun file, to viewers, or to both.

    Use `add_rerun_recorder` to make and connect it. It samples in periodic and forced publish events. If time
    goes back, it drops the samples from that time on. Viewers get the samples in batches. `flush` and `close`
    write the file atomically. Leaving the recorder as a context manager closes it, even after an error, and
    so does the end of the process if there are samples.

    Input ports (a shared one is declared once):
        body_poses (abstract list of RigidTransform): X_WB of all bodies, in plant order.
        contact_results (abstract ContactResults): contacts of the plant.
        <signal key> (n): any vector; <signal key>/0, 1, ... for a signal of several ports.
        <state key> (1): integer code.
        <hand key>/keypoints (63): p_HK, keypoint-major, m.
        <hand key>/wrist_pose (abstract RigidTransform): X_OH.
        <hand key>/valid (1): 1 tracked, 0 lost; if the hand has such a port.
        <points key> (3k): p_FP, point-major, m.
        <camera key>/color_image (abstract ImageRgba8U): image of the camera.
        <camera key>/body_pose (abstract RigidTransform): X_WB of the camera's body.

    Attributes:
        path: path of the file; None if there are only viewers.
    """

    def __init__(
        self,
        path: Path | None,
        specs: Mapping[str, Spec],
        inputs: Mapping[str, Sequence[str]],
        sources: Mapping[str, OutputPort],
        period: float,
        *,
        layout: Layout,
        viewers: Sequence[Viewer],
        properties: Mapping[str, Property],
    ):
        super().__init__()
        self.path = path
        self._specs, self._inputs = dict(specs), dict(inputs)
        self._layout, self._viewers = layout, list(viewers)
        self._properties = dict(properties)
        # Increasing times, s, with the rows of all specs; a row is None if none was due.
        self._samples: list[tuple[float, list]] = []
        self._read_at = dict.fromkeys(specs, -math.inf)  # s
        self._live: Writer | None = None
        self._sent = 0  # number of samples sent to the viewers
        self._sent_at = 0.0  # wall time, s
        self._closed = False
        for name, source in sources.items():
            if source.get_data_type() == PortDataType.kVectorValued:
                self.DeclareVectorInputPort(name, source.size())
            else:
                self.DeclareAbstractInputPort(name, source.Allocate())
        self._ports = {name: self.GetInputPort(name) for name in sources}
        self.DeclarePeriodicPublishEvent(period, 0.0, self._sample)
        self.DeclareForcedPublishEvent(self._sample)
        # Registered after Rerun's own handler, so it runs before Rerun shuts down.
        atexit.register(self._close_at_end)

    def set_properties(self, properties: Mapping[str, Property]) -> None:
        """Adds properties to the file, such as an outcome that is known only at the end.

        Raises:
            OutputError: the recorder is closed.
        """
        if self._closed:
            raise OutputError("the recorder is closed: set properties before it is")
        self._properties.update(properties)

    def flush(self) -> None:
        """Writes the file with all samples so far, and sends the remaining samples to viewers."""
        if self._closed:
            return
        if self._viewers and self._sent < len(self._samples):
            self._send()
        if self.path is None:
            return
        with file_writer(
            self.path,
            recording_id=self._digest(),
            blueprint=self._layout.blueprint(self._specs, self._columns(0)),
            properties=self._properties,
        ) as writer:
            self._write(writer, 0)

    def close(self) -> None:
        """Flushes and stops recording; closing again has no effect.

        If flushing fails, recording goes on; `close` can be called again, but not by the end of the process.
        """
        if self._closed:
            return
        atexit.unregister(self._close_at_end)
        self.flush()
        self._closed = True
        if self._live is not None:
            self._live.close()
        self._samples.clear()
        del self._specs, self._layout  # bodies and frames in them would keep the diagram alive

    def __enter__(self) -> "RerunRecorder":
        return self

    def __exit__(self, *_exception: object) -> None:
        self.close()

    def _close_at_end(self) -> None:
        # A failure before the simulation must not replace an earlier file.
        if not self._closed and self._samples:
            self.close()

    def _sample(self, context: Context) -> EventStatus:
        if self._closed:
            return EventStatus.DidNothing()
        now = context.get_time()
        while self._samples and self._samples[-1][0] >= now:  # time has gone back
            self._samples.pop()
        self._sent = min(self._sent, len(self._samples))
        values: dict[str, Any] = {}  # of the ports, which specs may share
        rows: list = []
        for key, spec in self._specs.items():
            if spec.period > 0.0:
                if self._read_at[key] <= now < self._read_at[key] + spec.period - 1e-9:
                    rows.append(None)
                    continue
                self._read_at[key] = now
            for name in self._inputs[key]:
                if name not in values:
                    values[name] = self._ports[name].Eval(context)
            rows.append(spec.read(*map(values.__getitem__, self._inputs[key])))
        self._samples.append((now, rows))
        if self._viewers and time.monotonic() >= self._sent_at + _BATCH_S:
            self._send()
        return EventStatus.Succeeded()

    def _columns(self, first: int) -> dict[str, Sequence]:
        """Returns the rows of every spec, from sample `first` on."""
        rows = [rows for _, rows in self._samples[first:]]
        columns = zip(*rows, strict=True) if rows else [()] * len(self._specs)
        return dict(zip(self._specs, columns, strict=True))

    def _send(self) -> None:
        """Sends new samples to the viewers; without a file, drops them afterwards."""
        if self._live is None:
            self._live = live_writer(
                self._viewers,
                blueprint=self._layout.blueprint(self._specs, self._columns(0)),
                name=self.path.stem if self.path else "live",
                properties=self._properties,
            )
        self._write(self._live, self._sent)
        if self.path is None:
            self._samples.clear()
        self._sent, self._sent_at = len(self._samples), time.monotonic()

    def _write(self, writer: Writer, first: int) -> None:
        self._layout.scene.write(writer)
        writer.at(np.array([now for now, _ in self._samples[first:]]))
        for key, rows in self._columns(first).items():
            self._specs[key].write(writer, key, rows)

    def _digest(self) -> str:
        """Computes a hash of the contents, so that equal simulations give equal recordings."""
        digest = hashlib.sha256(repr(sorted(self._properties.items())).encode())
        digest.update(np.array([now for now, _ in self._samples]).tobytes())
        for key, rows in self._columns(0).items():
            digest.update(repr(self._inputs[key]).encode())
            for row in rows:
                for part in row if isinstance(row, tuple) else (row,):
                    content = part.encode() if isinstance(part, str) else part
                    is_bytes = isinstance(content, bytes)
                    digest.update(content if is_bytes else np.asarray(content, float).tobytes())
        return digest.hexdigest()[:32]
