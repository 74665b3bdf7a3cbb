"""The recorder: a system that samples a plant and other ports, for a Rerun file and for viewers.

Samples are kept in memory and written once as columns, which takes far less time and space than logging each
body as it moves.
"""

import dataclasses
import functools
import hashlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun.blueprint as rrb
from numpy.typing import ArrayLike
from pydrake.geometry import Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, OutputPort, PortDataType

from geort_drake.errors import OutputError, ScenarioError
from geort_drake.files import require_writable
from geort_drake.rerun.layout import VIEW_FROM, default_layout, followed_bodies
from geort_drake.rerun.scene import ContactSpec, describe_plant
from geort_drake.rerun.specs import CloseUpSpec, Spec
from geort_drake.rerun.writer import ABOUT, Property, Viewer, Writer, file_writer, live_writer
from geort_drake.systems.python_system import PythonSystem

_BATCH_S = 0.1  # wall time between two batches for viewers


def add_rerun_recorder(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    path: str | os.PathLike | None,
    specs: Mapping[str, Spec] | None = None,
    *,
    viewers: Sequence[Viewer] = (),
    period: float = 0.02,
    role: Role = Role.kIllustration,
    contact: ContactSpec | None = None,
    close_ups: Mapping[str, CloseUpSpec] | None = None,
    view_from: ArrayLike = VIEW_FROM,
    properties: Mapping[str, Property] | None = None,
    text: str = "",
    plant_ports: Mapping[str, OutputPort] | None = None,
) -> "RerunRecorder":
    """Adds a Rerun recorder of a plant and other ports to a diagram.

    Args:
        builder: builder of the diagram that contains `plant` and all ports below. For a port inside a nested
            diagram, give the nested diagram's exported port; for a plant inside one, see `plant_ports`.
        plant: finalized plant.
        scene_graph: the scene graph with the plant's geometry.
        path: the .rrd file, whose folder is created if needed; None with viewers only.
        specs: entity path → what to record in addition to the plant: signals and states under /; hands and
            points under /world.
        viewers: open viewers, such as `rerun.GrpcSink("rerun+http://127.0.0.1:9876/proxy")`, or servers to
            which viewers connect, such as `rerun.GrpcServerSink`.
        period: time between samples, s.
        role: role of the geometry to draw; a body without any is drawn with its proximity geometry.
        contact: options for recording contact forces (point and hydroelastic contact).
        close_ups: name → additional view of the scene.
        view_from: direction in W from the scene to the eye.
        properties: facts that the viewer lists, such as {"method": "geort", "seed": 3}.
        text: Markdown for a panel that explains the recording; see `RerunRecorder.describe`.
        plant_ports: for a plant inside a nested diagram, the ports by which that diagram exports the plant's
            `body_poses` and `contact_results`.

    Raises:
        ScenarioError: there is neither a file nor a viewer, or a close-up follows a hand that is not
            recorded.
        OutputError: the file cannot be written.
        RuntimeError: Drake's message about a port that does not fit, a plant that is not finalized, or a
            system in another diagram.
    """
    if path is not None:
        require_writable(path)
    elif not viewers:
        raise ScenarioError("a recorder needs a file, viewers or both; given: neither")
    scene = describe_plant(plant, scene_graph, role, followed_bodies(close_ups or {}, specs or {}))
    all_specs: dict[str, Spec] = {
        "body_poses": scene,
        "contact_results": dataclasses.replace(contact or ContactSpec(), scene=scene),
        **(specs or {}),
    }
    ports = plant_ports or {}
    inputs: dict[str, list[str]] = {}
    sources: dict[str, OutputPort] = {}
    names: dict[tuple[Any, int], str] = {}
    for key, spec in all_specs.items():
        inputs[key] = []
        of_plant = lambda name: ports.get(name) or plant.GetOutputPort(name)  # noqa: E731
        for name, port in spec.ports(key, of_plant).items():
            # A port that several specs share is read once.
            inputs[key].append(names.setdefault((port.get_system(), int(port.get_index())), name))
            sources.setdefault(inputs[key][-1], port)
    recorder = RerunRecorder(
        None if path is None else Path(path),
        all_specs,
        inputs,
        sources,
        period,
        functools.partial(default_layout, dict(close_ups or {}), np.asarray(view_from, float), bool(text)),
        viewers,
        properties or {},
        text,
    )
    is_second = builder.HasSubsystemNamed("rerun_recorder")
    builder.AddNamedSystem(
        f"rerun_recorder_{len(builder.GetSystems())}" if is_second else "rerun_recorder", recorder
    )
    for name, source in sources.items():
        builder.Connect(source, recorder.GetInputPort(name))
    return recorder


class RerunRecorder(PythonSystem):
    """Records a plant and other ports to a Rerun file, to viewers, or to both; see `add_rerun_recorder`.

    It samples in periodic and forced publish events. If time goes back, it drops the samples from that time
    on. Viewers get the samples in batches. `flush` and `close` write the file atomically. Leaving the
    recorder as a context manager closes it, even after an error.

    Input ports (a shared one is declared once):
        body_poses (abstract list of RigidTransform): X_WB of all bodies, in plant order.
        contact_results (abstract ContactResults): contacts of the plant.
        <signal key> (n): any vector; <signal key>/0, 1, ... for a signal of several ports.
        <state key> (1): integer code.
        <hand key>/keypoints (63): p_HK, keypoint-major, m.
        <hand key>/wrist_pose (abstract RigidTransform): X_OH.
        <hand key>/valid (1): 1 tracked, 0 lost; if the hand has such a port.
        <points key> (3k): p_FP, point-major, m.

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
        layout: Callable[[Mapping[str, Spec], Mapping[str, Sequence]], rrb.Blueprint],
        viewers: Sequence[Viewer],
        properties: Mapping[str, Property],
        text: str,
    ):
        super().__init__()
        self.path = path
        self._name, self._text = path.stem if path else "live", text
        self._specs, self._inputs = dict(specs), dict(inputs)
        self._layout, self._viewers = layout, list(viewers)
        self._properties = dict(properties)
        self._samples: list[tuple[float, list]] = []  # increasing times, s, with the rows of all specs
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

    def set_properties(self, properties: Mapping[str, Property]) -> None:
        """Adds properties to the file, such as an outcome that is known only at the end.

        Raises:
            OutputError: the recorder is closed.
        """
        if self._closed:
            raise OutputError("the recorder is closed: set properties before it is")
        self._properties.update(properties)

    def describe(self, name: str, text: str) -> None:
        """Sets the recording's name in the viewer's list, and the Markdown of its panel."""
        self._name, self._text = name, text

    def table(self) -> pa.Table:
        """Returns the samples so far as a table with a row for each time.

        Its columns are t (s); signals, such as `joints.command.thumb.joint_12`, and contact forces (N) by
        their entity paths with dots; `state.NAME`, names of states; and `pose.MODEL.BODY`, lists
        qw qx qy qz x y z of X_WB, m.
        """
        columns = {"t": np.array([now for now, _ in self._samples])}
        for key, rows in self._columns(0).items():
            columns |= self._specs[key].samples(key, rows)
        return pa.table(
            {
                name: pa.FixedSizeListArray.from_arrays(values.ravel(), values.shape[1])
                if values.ndim == 2
                else values
                for name, values in columns.items()
            }
        )

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
            name=self._name,
            recording_id=self._digest(),
            blueprint=self._layout(self._specs, self._columns(0)),
            properties=self._properties,
        ) as writer:
            self._write(writer, 0)

    def close(self) -> None:
        """Flushes and stops recording; closing again has no effect.

        If flushing fails, recording goes on, and `close` can be called again.
        """
        if self._closed:
            return
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

    def _sample(self, context: Context) -> EventStatus:
        if self._closed:
            return EventStatus.DidNothing()
        now = context.get_time()
        while self._samples and self._samples[-1][0] >= now:  # time has gone back
            self._samples.pop()
        self._sent = min(self._sent, len(self._samples))
        values = {name: port.Eval(context) for name, port in self._ports.items()}
        rows = [spec.read(*(values[name] for name in self._inputs[key])) for key, spec in self._specs.items()]
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
                blueprint=self._layout(self._specs, self._columns(0)),
                name=self._name,
                properties=self._properties,
            )
        self._write(self._live, self._sent)
        if self.path is None:
            self._samples.clear()
        self._sent, self._sent_at = len(self._samples), time.monotonic()

    def _write(self, writer: Writer, first: int) -> None:
        if self._text:
            writer.text(ABOUT, self._text)
        writer.at(np.array([now for now, _ in self._samples[first:]]))
        for key, rows in self._columns(first).items():
            self._specs[key].write(writer, key, rows)

    def _digest(self) -> str:
        """Computes a hash of the contents, so that equal simulations give equal recordings."""
        digest = hashlib.sha256(repr((sorted(self._properties.items()), self._inputs)).encode())
        digest.update(np.array([now for now, _ in self._samples]).tobytes())
        for rows in self._columns(0).values():
            for row in rows:
                for part in row if isinstance(row, tuple) else (row,):
                    digest.update(part.encode() if isinstance(part, str) else np.asarray(part).tobytes())
        return digest.hexdigest()[:32]
