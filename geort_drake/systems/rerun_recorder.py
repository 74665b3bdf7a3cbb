"""Records any Drake diagram as a Rerun file: `add_rerun_recorder`.

Samples are kept in memory and written once, as columns: that costs far less time and space than
logging each body as it moves, and a file is either whole or absent.
"""

import atexit
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rerun.blueprint as rrb
from pydrake.common.value import Value
from pydrake.geometry import Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, RigidBody
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    EventStatus,
    LeafSystem,
    OutputPort,
    PortDataType,
)

from geort_drake.errors import ScenarioError
from geort_drake.systems._rerun_blueprint import grasp_blueprint
from geort_drake.systems._rerun_file import Recording
from geort_drake.systems._rerun_scene import Scene, describe_scene
from geort_drake.systems._rerun_tracks import (
    Color,
    ContactTrack,
    HandTrack,
    PointTrack,
    PoseTrack,
    SignalTrack,
    StateTrack,
    Track,
)

__all__ = [
    "ContactSpec",
    "HandSpec",
    "PointsSpec",
    "RerunRecorder",
    "SignalSpec",
    "StateSpec",
    "add_rerun_recorder",
    "grasp_blueprint",
]


@dataclass(frozen=True)
class SignalSpec:
    """A vector output port as one time series per element.

    Attributes:
        port: vector output port of any system of the diagram.
        names: one name per element. A slash opens a level of the tree, and the series that share
            it share a plot: "index/joint_0".
        label: what the legend adds to each name, such as "command".
        faint: drawn thin and pale, for what another signal is compared with.
    """

    port: OutputPort
    names: Sequence[str]
    label: str = ""
    faint: bool = False


@dataclass(frozen=True)
class HandSpec:
    """A human hand as a glove and a tracker give it.

    Attributes:
        keypoints_port: 63 numbers, p_HK, keypoint-major, m.
        wrist_pose_port: abstract `RigidTransform`, X_OH in the tracker's frame O.
        valid_port: size 1; the hand is drawn where it is over 0.5. Without it, always.
        color: red, green, blue, 0–255.
        X_WO: pose of the tracker's frame in the world, to place the hand beside the robot.
    """

    keypoints_port: OutputPort
    wrist_pose_port: OutputPort
    valid_port: OutputPort | None = None
    color: Color = (224, 172, 138)
    X_WO: RigidTransform = field(default_factory=RigidTransform)


@dataclass(frozen=True)
class PointsSpec:
    """A vector output port of 3k coordinates as k small spheres; points with a NaN are not drawn.

    Attributes:
        port: vector output port, point-major, m.
        frame: frame of the plant that the coordinates are measured in; the world by default.
        radius: m.
        color: red, green, blue, 0–255.
    """

    port: OutputPort
    frame: Frame | None = None
    radius: float = 0.006
    color: Color = (255, 80, 200)


@dataclass(frozen=True)
class StateSpec:
    """A port of size 1 that holds an integer code, as a lane of named states.

    Attributes:
        port: vector output port of size 1.
        labels: names of the codes 0, 1, ..., or a mapping from code to name.
    """

    port: OutputPort
    labels: Sequence[str] | Mapping[int, str]


@dataclass(frozen=True)
class ContactSpec:
    """How contact forces are shown.

    Attributes:
        groups: bodies whose contact forces are summed to one time series each, such as the links
            of a finger: {"thumb": [link_12, ...]}. By default every moving body that was touched.
        metres_per_newton: length of the arrows.
        max_length: longer arrows are cut to this, m.
    """

    groups: Mapping[str, Sequence[RigidBody]] | None = None
    metres_per_newton: float = 0.02
    max_length: float = 0.25


class RerunRecorder(LeafSystem):
    """Samples a plant and further ports, and writes them to a Rerun file at `close`.

    Input ports:
        body_poses (abstract list of RigidTransform): X_WB of all bodies, in plant order.
        contact_results (abstract ContactResults): when contact is recorded.
        <signal key> (n): any vector, in the unit its names say.
        <state key> (1): integer code.
        <hand key>/keypoints (63): p_HK, keypoint-major, m.
        <hand key>/wrist_pose (abstract RigidTransform): X_OH.
        <hand key>/valid (1): 1 tracked, 0 lost; where the hand has one.
        <points key> (3k): p_FP, point-major, m.

    Made and connected by `add_rerun_recorder`. It is a context manager: leaving it writes the file,
    also when the simulation raised. What was not closed is written when the process ends: Drake
    keeps systems written in Python alive until then. Samples are taken in publish events. Going
    back in time, as a simulator that is initialized anew does, drops the samples from there on.
    """

    def __init__(self, recording: Recording, sources: Mapping[str, OutputPort], period: float):
        super().__init__()
        self._recording = recording
        self._sources = list(sources)
        for name, source in sources.items():
            if source.get_data_type() == PortDataType.kVectorValued:
                self.DeclareVectorInputPort(name, source.size())
            else:
                self.DeclareAbstractInputPort(name, source.Allocate())
        self.DeclarePeriodicPublishEvent(period, 0.0, self._sample)
        # Registered after Rerun's own, and therefore run before Rerun shuts down.
        atexit.register(recording.close)

    @property
    def path(self) -> Path:
        """Where the file is written."""
        return self._recording.path

    @property
    def times(self) -> np.ndarray:
        """Times (T,) of the samples taken so far, s."""
        return np.array(self._recording.times)

    def set_properties(self, properties: Mapping[str, str | int | float | bool]) -> None:
        """Adds to what the recording says of itself, such as an outcome known only at the end."""
        self._recording.properties.update(properties)

    def close(self) -> None:
        """Writes the file; samples after that are not kept, and closing again does nothing."""
        atexit.unregister(self._recording.close)
        self._recording.close()

    def __enter__(self) -> "RerunRecorder":
        return self

    def __exit__(self, *_exception) -> None:
        self.close()

    def _sample(self, context: Context) -> EventStatus:
        if self._recording.closed:
            return EventStatus.DidNothing()
        values = {name: self.GetInputPort(name).Eval(context) for name in self._sources}
        rows = [track.read(*(values[name] for name in track.ports)) for track in self._recording.tracks]
        self._recording.append(context.get_time(), rows)
        return EventStatus.Succeeded()


def add_rerun_recorder(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    path: str | os.PathLike,
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
    properties: Mapping[str, str | int | float | bool] | None = None,
    blueprint: rrb.Blueprint | None = None,
) -> RerunRecorder:
    """Adds a recorder of the plant, and of any further ports, to a diagram.

    Args:
        builder: of the diagram that holds `plant`, `scene_graph` and every port given below.
        plant: finalized.
        path: the .rrd file. Its directory is made when needed.
        application_id: recordings that share it share a layout in the viewer.
        recording_id: recordings with the same id are merged by the viewer; by default made of the
            contents, so that the same simulation gives the same recording.
        period: of the samples, s.
        role: which geometry to draw; a body without any is drawn with its proximity geometry.
        contact: whether, or how, contact forces are recorded (point and hydroelastic contact).
        signals: entity path to time series, under /.
        hands: entity path to human hand, under /world.
        points: entity path to points, under /world.
        states: entity path to states, under /.
        properties: what the recording is about, such as {"method": "geort", "seed": 3}.
        blueprint: layout; by default `grasp_blueprint` for what is recorded.

    Raises:
        ScenarioError: the plant is not finalized, the period is not positive, or a port does not fit.
    """
    if not plant.is_finalized():
        raise ScenarioError(f"{path}: the plant '{plant.get_name()}' must be finalized before it is recorded")
    if not period > 0:
        raise ScenarioError(f"{path}: period must be positive, s; given {period}")
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
    recording = Recording(
        path,
        scene,
        tracks,
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
