"""Records any Drake diagram for the Rerun viewer: `add_rerun_recorder`.

Samples are kept in memory and written once, as columns: that costs far less time and space than
logging each body as it moves, and a file is either whole or absent. Viewers that look on get the same
columns, in batches.
"""

import atexit
import functools
import os
import weakref
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.geometry import Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    EventStatus,
    InputPortIndex,
    LeafSystem,
    OutputPort,
    PortDataType,
)

from geort_drake.errors import ScenarioError
from geort_drake.rerun.blueprint import grasp_blueprint
from geort_drake.rerun.file import VIEW_FROM, Recording
from geort_drake.rerun.inputs import Inputs, check_connectable, follow, ports_of_plant
from geort_drake.rerun.scene import describe_scene
from geort_drake.rerun.specs import (
    CameraSpec,
    CloseUpSpec,
    ContactSpec,
    HandSpec,
    PointsSpec,
    SignalSpec,
    StateSpec,
)
from geort_drake.rerun.writer import LiveSink, Property, is_live, live_sink

__all__ = [
    "CameraSpec",
    "CloseUpSpec",
    "ContactSpec",
    "HandSpec",
    "PointsSpec",
    "RerunRecorder",
    "SignalSpec",
    "StateSpec",
    "add_rerun_recorder",
    "grasp_blueprint",
]

# A file, a viewer's address, or what Rerun makes of one.
Target = str | os.PathLike | LiveSink


class RerunRecorder(LeafSystem):
    """Samples a plant and further ports, for a Rerun file, for viewers, or for both.

    Input ports:
        body_poses (abstract list of RigidTransform): X_WB of all bodies, in plant order.
        contact_results (abstract ContactResults): when contact is recorded.
        <signal key> (n): any vector; of a signal of several ports <signal key>/<name of the port>.
        <state key> (1): integer code.
        <hand key>/keypoints (63): p_HK, keypoint-major, m.
        <hand key>/wrist_pose (abstract RigidTransform): X_OH.
        <hand key>/valid (1): 1 tracked, 0 lost; where the hand has one.
        <points key> (3k): p_FP, point-major, m.
        <camera key>/color_image (abstract ImageRgba8U).
        <camera key>/body_pose (abstract RigidTransform): X_WB of the camera's body.

    A port that several of them would read is read by the first alone.

    Made and connected by `add_rerun_recorder`. Samples are taken in publish events, periodic and forced.
    Going back in time, as a simulator that is initialized anew does, drops the samples from there on.

    The file is written by `flush`, by `close`, and on leaving the recorder as a context manager, also when
    the simulation raised. What is not in it by then is written when the simulator goes away, or else when
    the process ends.
    """

    def __init__(self, recording: Recording, sources: Mapping[str, OutputPort], period: float):
        super().__init__()
        self._recording = recording
        # Of each port, what copies its value, which then goes on holding when the simulation does.
        self._copies: dict[str, Callable[[Context], Any]] = {}
        for name, source in sources.items():
            if source.get_data_type() == PortDataType.kVectorValued:
                self._copies[name] = self.DeclareVectorInputPort(name, source.size()).Eval
            else:
                index = self.DeclareAbstractInputPort(name, source.Allocate()).get_index()
                self._copies[name] = functools.partial(self._clone, index)
        self.DeclarePeriodicPublishEvent(period, 0.0, self._sample)
        self.DeclareForcedPublishEvent(self._sample)
        # Drake never lets go of systems written in Python, but it does of the contexts they run in.
        self._token = self.DeclareAbstractState(AbstractValue.Make(_Token()))
        self.DeclareInitializationPublishEvent(self._watch)
        # Registered after Rerun's own, and therefore run before Rerun shuts down.
        atexit.register(recording.close)

    @property
    def path(self) -> Path | None:
        """Where the file is written; None where only viewers look on."""
        return self._recording.path

    @property
    def times(self) -> np.ndarray:
        """Times (T,) of the samples that are kept, s; without a file, of those that no viewer has got."""
        return np.array(self._recording.times)

    def set_properties(self, properties: Mapping[str, Property]) -> None:
        """Adds to what the recording says of itself, such as an outcome known only at the end."""
        self._recording.set_properties(properties)

    def flush(self) -> None:
        """Writes the file with all samples so far, and sends viewers what they have not got."""
        self._recording.flush()

    def close(self) -> None:
        """Flushes; samples after that are not kept, and closing again does nothing."""
        self._recording.close()
        atexit.unregister(self._recording.close)

    def __enter__(self) -> "RerunRecorder":
        return self

    def __exit__(self, *_exception: object) -> None:
        self.close()

    def _watch(self, context: Context) -> EventStatus:
        token = context.get_abstract_state(self._token).get_value()
        weakref.finalize(token, self._recording.flush).atexit = False
        return EventStatus.Succeeded()

    def _sample(self, context: Context) -> EventStatus:
        if self._recording.closed:
            return EventStatus.DidNothing()
        time = context.get_time()
        copies: dict[str, Any] = {}
        sample: list[tuple | None] = []
        for track in self._recording.tracks:
            if not track.due(time):
                sample.append(None)
                continue
            for name in track.ports:
                if name not in copies:
                    copies[name] = self._copies[name](context)
            sample.append(tuple(copies[name] for name in track.ports))
        self._recording.append(time, sample)
        return EventStatus.Succeeded()

    def _clone(self, index: InputPortIndex, context: Context) -> AbstractValue:
        return self.EvalAbstractInput(context, index).Clone()


class _Token:
    """Lives as long as the context that holds it; a copy of the context holds one of its own."""

    def __deepcopy__(self, _memo: dict) -> "_Token":
        return _Token()


def add_rerun_recorder(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    path_or_viewer: Target | Sequence[Target],
    *,
    application_id: str = "geort_drake",
    recording_id: str | None = None,
    period: float = 0.02,
    role: Role = Role.kIllustration,
    contact: bool | ContactSpec = True,
    signals: Mapping[str, SignalSpec] | None = None,
    hands: Mapping[str, HandSpec] | None = None,
    points: Mapping[str, PointsSpec] | None = None,
    states: Mapping[str, StateSpec] | None = None,
    cameras: Mapping[str, CameraSpec] | None = None,
    close_ups: Mapping[str, CloseUpSpec] | None = None,
    view_from: ArrayLike = VIEW_FROM,
    properties: Mapping[str, Property] | None = None,
    blueprint: rrb.Blueprint | None = None,
    plant_ports: Mapping[str, OutputPort] | None = None,
) -> RerunRecorder:
    """Adds a recorder of the plant, and of any further ports, to a diagram.

    Args:
        builder: of the diagram that holds `plant` and every port given below. Of a plant, or a port, in a
            diagram inside that one, the inner diagram's exported ports are given; see `plant_ports`.
        plant: finalized.
        path_or_viewer: the .rrd file, whose directory is made when needed; or a viewer that is open
            meanwhile, by its address "rerun+http://127.0.0.1:9876/proxy", or as `rerun.GrpcSink` or
            `rerun.GrpcServerSink`; or several of these, at most one of them a file.
        application_id: recordings that share it share a layout in the viewer.
        recording_id: recordings with the same id are merged by the viewer; by default a file's is made of
            its contents, so that the same simulation gives the same recording.
        period: of the samples, s.
        role: which geometry to draw; a body without any is drawn with its proximity geometry.
        contact: whether, or how, contact forces are recorded (point and hydroelastic contact).
        signals: entity path to time series, under /.
        hands: entity path to human hand, under /world.
        points: entity path to points, under /world.
        states: entity path to states, under /.
        cameras: entity path to camera, under /world.
        close_ups: name to one more view of the scene, in the default layout.
        view_from: direction in W from the scene to the eye, in the default layout.
        properties: what the recording is about, such as {"method": "geort", "seed": 3}.
        blueprint: layout; by default `grasp_blueprint` for what is recorded.
        plant_ports: where the plant is in a diagram inside the builder's: the ports by which that one exports
            the plant's `body_poses` and, if contact is recorded, `contact_results`, by these names.

    Raises:
        ScenarioError: the plant is not finalized, or is in another diagram and its ports are not given; the
            period is not positive, or `view_from` no direction; a port does not fit, or is in another
            diagram; or there is more than one file. Nothing has been added to the builder then.
    """
    path, sinks = _targets(path_or_viewer)
    where = path or "live recording"
    if not plant.is_finalized():
        raise ScenarioError(
            f"{where}: the plant '{plant.get_name()}' must be finalized before it is recorded"
        )
    if not period > 0:
        raise ScenarioError(f"{where}: period must be positive, s; given {period}")
    if np.shape(view_from) != (3,) or not 0 < np.linalg.norm(view_from) < np.inf:
        raise ScenarioError(f"{where}: view_from must be three numbers, not all 0; given {view_from!r}")
    names = ["body_poses", *(["contact_results"] if contact else [])]
    ports = ports_of_plant(where, builder, plant, names, plant_ports)
    views = [follow(name, spec, hands or {}) for name, spec in (close_ups or {}).items()]
    scene = describe_scene(plant, scene_graph, role, [view.follows for view in views])
    inputs = Inputs(scene, ports)
    if contact:
        inputs.add_contact(contact if isinstance(contact, ContactSpec) else ContactSpec())
    for key, state in (states or {}).items():
        inputs.add_state(key, state)
    for key, signal in (signals or {}).items():
        inputs.add_signal(key, signal)
    for key, hand in (hands or {}).items():
        inputs.add_hand(key, hand)
    for key, cloud in (points or {}).items():
        inputs.add_points(key, cloud)
    for key, camera in (cameras or {}).items():
        inputs.add_camera(key, camera)
    check_connectable(where, builder, inputs.sources)
    recording = Recording(
        path,
        scene,
        inputs.tracks,
        sinks=sinks,
        application_id=application_id,
        recording_id=recording_id,
        properties=properties or {},
        blueprint=blueprint,
        close_ups=views,
        view_from=view_from,
    )
    recorder = RerunRecorder(recording, inputs.sources, period)
    recorder.set_name("rerun_recorder")
    builder.AddSystem(recorder)
    for name, source in inputs.sources.items():
        builder.Connect(source, recorder.GetInputPort(name))
    return recorder


def _targets(path_or_viewer: Target | Sequence[Target]) -> tuple[Path | None, list[LiveSink]]:
    """The file, if any, and the viewers."""
    single = isinstance(path_or_viewer, str | os.PathLike) or is_live(path_or_viewer)
    targets: Sequence[Any] = [path_or_viewer] if single else list(path_or_viewer)  # type: ignore[arg-type]
    files = [target for target in targets if not is_live(target)]
    if not targets or len(files) > 1:
        given = ", ".join(map(str, targets)) or "nothing"
        raise ScenarioError(f"a recorder takes one file, viewers, or both; given: {given}")
    return Path(files[0]) if files else None, [live_sink(target) for target in targets if is_live(target)]
