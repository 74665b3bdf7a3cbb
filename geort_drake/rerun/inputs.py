"""From what a recorder is asked for to the ports it reads and the tracks it keeps."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import DiagramBuilder, OutputPort, PortDataType

from geort_drake.errors import ScenarioError
from geort_drake.rerun.camera import CameraTrack
from geort_drake.rerun.contact import ContactTrack
from geort_drake.rerun.file import CloseUpView
from geort_drake.rerun.hand import HandTrack
from geort_drake.rerun.points import PointTrack
from geort_drake.rerun.scene import Scene
from geort_drake.rerun.specs import (
    CameraSpec,
    CloseUpSpec,
    ContactSpec,
    Derive,
    HandSpec,
    PointsSpec,
    SignalSpec,
    StateSpec,
)
from geort_drake.rerun.tracks import PoseTrack, SignalTrack, StateTrack, Track


class Inputs:
    """What is recorded, kind by kind.

    Attributes:
        sources: name of an input port of the recorder → output port that it reads.
        tracks: what is kept of them.
    """

    def __init__(self, scene: Scene, plant_ports: Mapping[str, OutputPort]):
        self.sources: dict[str, OutputPort] = {"body_poses": plant_ports["body_poses"]}
        self.tracks: list[Track] = [PoseTrack(scene)]
        self._scene = scene
        self._plant_ports = plant_ports

    def add_contact(self, spec: ContactSpec) -> None:
        groups = None
        if spec.groups is not None:
            groups = {name: [int(body.index()) for body in bodies] for name, bodies in spec.groups.items()}
        self._read("contact_results", self._plant_ports["contact_results"])
        self.tracks.append(ContactTrack(self._scene, groups, spec.metres_per_newton, spec.max_length))

    def add_signal(self, key: str, spec: SignalSpec) -> None:
        size = len(spec.names)
        ports = [spec.port] if isinstance(spec.port, OutputPort) else list(spec.port)
        if spec.derive is None and len(ports) == 1:
            names = [self._vector(key, ports[0], size, "its names")]
        else:
            names = [self._vector(f"{key}/{p.get_name()}" if len(ports) > 1 else key, p) for p in ports]
            _check_derived(key, spec.derive, sum(port.size() for port in ports), size, "its names")
        if spec.colors is not None and len(spec.colors) != size:
            raise ScenarioError(f"recording of '{key}': {size} names and {len(spec.colors)} colors")
        self.tracks.append(
            SignalTrack(
                key,
                spec.names,
                spec.label,
                spec.faint,
                title=spec.title,
                unit=spec.unit,
                page=spec.page,
                legend=spec.legend,
                limits=spec.limits,
                colors=spec.colors,
                derive=spec.derive,
                ports=names,
            )
        )

    def add_state(self, key: str, spec: StateSpec) -> None:
        labels = spec.labels if isinstance(spec.labels, Mapping) else dict(enumerate(spec.labels))
        self.tracks.append(StateTrack(key, labels, port=self._vector(key, spec.port, 1, "a state code")))

    def add_hand(self, key: str, spec: HandSpec) -> None:
        names = [
            self._vector(f"{key}/keypoints", spec.keypoints_port, 63, "21 keypoints"),
            self._read(f"{key}/wrist_pose", _pose(f"{key}/wrist_pose", spec.wrist_pose_port)),
        ]
        if spec.valid_port is not None:
            names.append(self._vector(f"{key}/valid", spec.valid_port, 1, "a flag"))
        self.tracks.append(HandTrack(key, spec.color, spec.X_WO, names))

    def add_points(self, key: str, spec: PointsSpec) -> None:
        port = self._vector(key, spec.port)
        size = spec.port.size()
        if spec.derive is not None:
            size = np.size(spec.derive(np.zeros((1, size))))
        count = size // 3
        if not count or size % 3:
            raise ScenarioError(
                f"recording of '{key}': {_full_name(spec.port)} gives {size} numbers; wanted 3 per point"
            )
        if np.ndim(spec.color) == 2 and len(spec.color) != count:
            raise ScenarioError(f"recording of '{key}': {count} points and {len(spec.color)} colors")
        self.tracks.append(PointTrack(key, port, count, spec, fixed_in_body(spec.frame)))

    def add_camera(self, key: str, spec: CameraSpec) -> None:
        self._read(f"{key}/color_image", spec.sensor.color_image_output_port())
        self._read(f"{key}/body_pose", spec.sensor.body_pose_in_world_output_port())
        self.tracks.append(CameraTrack(key, spec.sensor, spec.period))

    def _vector(self, key: str, port: OutputPort, size: int | None = None, meaning: str = "") -> str:
        """Has a vector port read, of that size if one is given; returns the name of the input."""
        if port.get_data_type() != PortDataType.kVectorValued:
            raise ScenarioError(f"recording of '{key}': {_full_name(port)} is abstract; wanted a vector port")
        if size is not None and port.size() != size:
            raise ScenarioError(
                f"recording of '{key}': {_full_name(port)} has size {port.size()}; wanted {size}, "
                f"for {meaning}"
            )
        return self._read(key, port)

    def _read(self, name: str, port: OutputPort) -> str:
        """Has a port read under a name, or under the one that it has already."""
        for known, source in self.sources.items():
            if source.get_system() is port.get_system() and source.get_index() == port.get_index():
                return known
        self.sources[name] = port
        return name


def ports_of_plant(
    where: object,
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    names: Sequence[str],
    given: Mapping[str, OutputPort] | None,
) -> dict[str, OutputPort]:
    """The plant's ports with these names, or those that another diagram exports in their place.

    Raises:
        ScenarioError: the plant is in another diagram and ports are not given; or they are not the plant's.
    """
    own = {name: plant.GetOutputPort(name) for name in names}
    if given is None:
        if not _holds(builder, plant):
            raise ScenarioError(
                f"{where}: the plant '{plant.get_name()}' is not in the diagram that the recorder is added "
                f"to. If it is in a diagram inside that one, export there: {' and '.join(names)}, as by "
                f'inner.ExportOutput(plant.GetOutputPort("{names[0]}"), "{names[0]}"), and give the recorder '
                f'plant_ports={{"{names[0]}": inner_diagram.GetOutputPort("{names[0]}"), ...}}'
            )
        return own
    if set(given) != set(names):
        wanted = " and ".join(names)
        raise ScenarioError(f"{where}: plant_ports must be {wanted}, not {', '.join(given) or 'empty'}")
    for name, port in given.items():
        if type(port.Allocate()) is not type(own[name].Allocate()):
            raise ScenarioError(f"{where}: plant_ports: {_full_name(port)} does not hold {name}")
    return dict(given)


def check_connectable(where: object, builder: DiagramBuilder, sources: Mapping[str, OutputPort]) -> None:
    """Raises ScenarioError if a port belongs to a system inside another diagram than the builder's."""
    for name, port in sources.items():
        if not _holds(builder, port.get_system()):
            raise ScenarioError(
                f"{where}: '{name}': {_full_name(port)} is not in the diagram that the recorder is added to. "
                "If it is in a diagram inside that one, export it there (ExportOutput), and give the port of "
                "that diagram"
            )


def follow(name: str, spec: CloseUpSpec, hands: Collection[str]) -> CloseUpView:
    """The view that a spec describes, in the frame of a body or of a hand's wrist.

    Raises:
        ScenarioError: it follows a hand that is not recorded.
    """
    glass = [int(body.index()) for body in spec.see_through]
    eye, target = np.asarray(spec.eye, float), np.asarray(spec.target, float)
    if isinstance(spec.follows, str):
        if spec.follows not in hands:
            raise ScenarioError(
                f"close-up '{name}' follows the hand '{spec.follows}'; the recorded hands are: "
                f"{', '.join(hands) or 'none'}"
            )
        return CloseUpView(name, spec.follows, eye, target, glass)
    body, X_BF = fixed_in_body(spec.follows)
    return CloseUpView(name, body, X_BF @ eye, X_BF @ target, glass)


def fixed_in_body(frame: Frame | None) -> Any:
    """Index of the body that carries a frame F, and X_BF; None for no frame."""
    if frame is None:
        return None
    return int(frame.body().index()), frame.GetFixedPoseInBodyFrame()


def _holds(builder: DiagramBuilder, system: Any) -> bool:
    return any(one is system for one in builder.GetSystems())


def _check_derived(key: str, derive: Derive | None, given: int, wanted: int, meaning: str) -> None:
    made = np.zeros((1, given)) if derive is None else derive(np.zeros((1, given)))
    if np.shape(made) != (1, wanted):
        raise ScenarioError(
            f"recording of '{key}': of (1, {given}) values it makes {np.shape(made)}; wanted (1, {wanted}), "
            f"for {meaning}"
        )


def _pose(key: str, port: OutputPort) -> OutputPort:
    value: Any = port.Allocate()
    if not isinstance(value, Value[RigidTransform]):
        raise ScenarioError(f"recording of '{key}': {_full_name(port)} does not hold a RigidTransform")
    return port


def _full_name(port: OutputPort) -> str:
    system: Any = port.get_system()
    return f"port '{port.get_name()}' of '{system.get_name()}'"
