"""Records any Drake diagram for the Rerun viewer: `add_rerun_recorder`.

Samples are kept in memory and written once, as columns: that costs far less time and space than
logging each body as it moves, and a file is either whole or absent. Viewers that look on get the same
columns, in batches.
"""

import atexit
import os
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun.blueprint as rrb
from pydrake.common.value import AbstractValue, Value
from pydrake.geometry import Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    EventStatus,
    InputPort,
    LeafSystem,
    OutputPort,
    PortDataType,
)

from geort_drake.errors import ScenarioError
from geort_drake.systems._rerun_blueprint import grasp_blueprint
from geort_drake.systems._rerun_camera import CameraTrack
from geort_drake.systems._rerun_contact import ContactTrack
from geort_drake.systems._rerun_file import Recording
from geort_drake.systems._rerun_hand import HandTrack
from geort_drake.systems._rerun_scene import Scene, describe_scene
from geort_drake.systems._rerun_specs import (
    CameraSpec,
    ContactSpec,
    HandSpec,
    PointsSpec,
    SignalSpec,
    StateSpec,
)
from geort_drake.systems._rerun_tracks import PointTrack, PoseTrack, SignalTrack, StateTrack, Track
from geort_drake.systems._rerun_writer import LiveSink, Property, is_live, live_sink

__all__ = [
    "CameraSpec",
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
        <signal key> (n): any vector, in the unit its names say.
        <state key> (1): integer code.
        <hand key>/keypoints (63): p_HK, keypoint-major, m.
        <hand key>/wrist_pose (abstract RigidTransform): X_OH.
        <hand key>/valid (1): 1 tracked, 0 lost; where the hand has one.
        <points key> (3k): p_FP, point-major, m.
        <camera key>/color_image (abstract ImageRgba8U).
        <camera key>/body_pose (abstract RigidTransform): X_WB of the camera's body.

    Made and connected by `add_rerun_recorder`. Samples are taken in publish events, periodic and forced.
    Going back in time, as a simulator that is initialized anew does, drops the samples from there on.

    The file is written by `flush`, by `close`, and on leaving the recorder as a context manager, also when
    the simulation raised. What is not in it by then is written when the simulator goes away, or else when
    the process ends.
    """

    def __init__(self, recording: Recording, sources: Mapping[str, OutputPort], period: float):
        super().__init__()
        self._recording = recording
        self._inputs = {}
        for name, source in sources.items():
            if source.get_data_type() == PortDataType.kVectorValued:
                self._inputs[name] = self.DeclareVectorInputPort(name, source.size())
            else:
                self._inputs[name] = self.DeclareAbstractInputPort(name, source.Allocate())
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

    def __exit__(self, *_exception) -> None:
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
                    copies[name] = self._copy(context, self._inputs[name])
            sample.append(tuple(copies[name] for name in track.ports))
        self._recording.append(time, sample)
        return EventStatus.Succeeded()

    def _copy(self, context: Context, port: InputPort) -> np.ndarray | AbstractValue:
        """The value of a port, which goes on holding when the simulation does."""
        if port.get_data_type() == PortDataType.kVectorValued:
            return port.Eval(context)
        return self.EvalAbstractInput(context, port.get_index()).Clone()


class _Token:
    """Lives as long as the context that holds it; a copy of the context holds one of its own."""

    def __deepcopy__(self, _memo) -> "_Token":
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
    properties: Mapping[str, Property] | None = None,
    blueprint: rrb.Blueprint | None = None,
) -> RerunRecorder:
    """Adds a recorder of the plant, and of any further ports, to a diagram.

    Args:
        builder: of the diagram that holds `plant`, `scene_graph` and every port given below.
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
        properties: what the recording is about, such as {"method": "geort", "seed": 3}.
        blueprint: layout; by default `grasp_blueprint` for what is recorded.

    Raises:
        ScenarioError: the plant is not finalized, the period is not positive, a port does not fit, or
            there is more than one file.
    """
    path, sinks = _targets(path_or_viewer)
    where = path or "live recording"
    if not plant.is_finalized():
        raise ScenarioError(
            f"{where}: the plant '{plant.get_name()}' must be finalized before it is recorded"
        )
    if not period > 0:
        raise ScenarioError(f"{where}: period must be positive, s; given {period}")
    scene = describe_scene(plant, scene_graph, role)
    sources: dict[str, OutputPort] = {"body_poses": plant.get_body_poses_output_port()}
    tracks: list[Track] = [PoseTrack(scene)]
    if contact:
        spec = contact if isinstance(contact, ContactSpec) else ContactSpec()
        tracks.append(_contact_track(scene, spec))
        sources["contact_results"] = plant.get_contact_results_output_port()
    for key, signal in (signals or {}).items():
        sources[key] = _vector(key, signal.port, len(signal.names), "its names")
        tracks.append(SignalTrack(key, signal.names, signal.label, signal.faint))
    for key, state in (states or {}).items():
        sources[key] = _vector(key, state.port, 1, "a state code")
        labels = state.labels if isinstance(state.labels, Mapping) else dict(enumerate(state.labels))
        tracks.append(StateTrack(key, labels))
    for key, hand in (hands or {}).items():
        sources[f"{key}/keypoints"] = _vector(f"{key}/keypoints", hand.keypoints_port, 63, "21 keypoints")
        sources[f"{key}/wrist_pose"] = _pose(f"{key}/wrist_pose", hand.wrist_pose_port)
        if hand.valid_port is not None:
            sources[f"{key}/valid"] = _vector(f"{key}/valid", hand.valid_port, 1, "a flag")
        tracks.append(HandTrack(key, hand.color, hand.X_WO, hand.valid_port is not None))
    for key, cloud in (points or {}).items():
        sources[key] = _vector(key, cloud.port, 3 * max(1, cloud.port.size() // 3), "points of 3 coordinates")
        tracks.append(PointTrack(key, cloud.radius, cloud.color, _fixed_in_body(cloud.frame)))
    for key, camera in (cameras or {}).items():
        sources[f"{key}/color_image"] = camera.sensor.color_image_output_port()
        sources[f"{key}/body_pose"] = camera.sensor.body_pose_in_world_output_port()
        tracks.append(CameraTrack(key, camera.sensor, camera.period))
    recording = Recording(
        path,
        scene,
        tracks,
        sinks=sinks,
        application_id=application_id,
        recording_id=recording_id,
        properties=properties or {},
        blueprint=blueprint,
    )
    recorder = RerunRecorder(recording, sources, period)
    recorder.set_name("rerun_recorder")
    builder.AddSystem(recorder)
    for name, source in sources.items():
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


def _contact_track(scene: Scene, spec: ContactSpec) -> ContactTrack:
    groups = None
    if spec.groups is not None:
        groups = {name: [int(body.index()) for body in bodies] for name, bodies in spec.groups.items()}
    return ContactTrack(scene, groups, spec.metres_per_newton, spec.max_length)


def _fixed_in_body(frame: Frame | None) -> tuple[int, RigidTransform] | None:
    """Index of the body that carries a frame F, and X_BF."""
    if frame is None:
        return None
    return int(frame.body().index()), frame.GetFixedPoseInBodyFrame()


def _vector(key: str, port: OutputPort, size: int, meaning: str) -> OutputPort:
    if port.get_data_type() != PortDataType.kVectorValued:
        raise ScenarioError(f"recording of '{key}': {_full_name(port)} is abstract; wanted a vector port")
    if port.size() != size:
        raise ScenarioError(
            f"recording of '{key}': {_full_name(port)} has size {port.size()}; wanted {size}, for {meaning}"
        )
    return port


def _pose(key: str, port: OutputPort) -> OutputPort:
    value: Any = port.Allocate()
    if not isinstance(value, Value[RigidTransform]):
        raise ScenarioError(f"recording of '{key}': {_full_name(port)} does not hold a RigidTransform")
    return port


def _full_name(port: OutputPort) -> str:
    system: Any = port.get_system()
    return f"port '{port.get_name()}' of '{system.get_name()}'"
