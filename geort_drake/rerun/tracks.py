"""Tracks of a recorder. Each class reads one kind of port and writes Rerun columns."""

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from PIL import Image
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ContactResults
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import OutputPort, PortDataType
from pydrake.systems.sensors import ImageRgba8U

from geort_drake.colours import FINGER_COLOURS, Color, rgb
from geort_drake.errors import ScenarioError
from geort_drake.rerun.scene import Scene
from geort_drake.rerun.specs import CameraSpec, ContactSpec, HandSpec, PointsSpec, SignalSpec, StateSpec
from geort_drake.rerun.writer import PALETTE, SOLID, WORLD, Writer, entity_path
from geort_drake.systems.contacts import contact_rows

_CONTACT_COLOR: Color = (255, 200, 40)
_JPEG_QUALITY = 85  # a tenth of the size of PNG
_IMAGE_DISTANCE = 0.15  # m; how far in front of the camera its image is drawn in the scene


class Track:
    """Rows sampled from output ports, at most once per `period`, s.

    Attributes:
        ports: name of an input port of the recorder → output port to read.
        inputs: names of the recorder's input ports that provide these values; set by the recorder, which
            reads a port that several tracks share only once.
        rows: one per sample; None where no value was due.
        large: whether the ports' values are too large to keep many of them.
    """

    large = False

    def __init__(self, ports: Mapping[str, OutputPort], period: float = 0.0):
        self.ports = dict(ports)
        self.inputs: list[str] = []
        self.rows: list = []
        self._period = period
        self._read_at = -math.inf

    def due(self, time: float) -> bool:
        """Whether to read at this time, s; if so, the next reading is a period later."""
        if self._read_at <= time < self._read_at + self._period - 1e-9:
            return False
        self._read_at = time
        return True

    def read(self, *values: Any) -> Any:
        """One row from the values of the ports."""
        raise NotImplementedError

    def write(self, writer: Writer, rows: Sequence) -> None:
        """Sends rows, one for each of the writer's times."""
        raise NotImplementedError


class PoseTrack(Track):
    """Poses of all moving bodies: rows (bodies, 3, 4), X_WB."""

    def __init__(self, scene: Scene, port: OutputPort):
        super().__init__({"body_poses": port})
        self._paths = [scene.paths[i] for i in scene.moving]
        self._indices = list(scene.moving)

    def read(self, body_poses: Sequence[RigidTransform]) -> np.ndarray:
        return np.array([body_poses[i].GetAsMatrix34() for i in self._indices])

    def poses(self, rows: Sequence[np.ndarray]) -> np.ndarray:
        """X_WB (T, bodies, 3, 4) of the moving bodies, in plant order."""
        return np.reshape(rows, (len(rows), len(self._indices), 3, 4))

    def write(self, writer: Writer, rows: Sequence[np.ndarray]) -> None:
        writer.poses(self._paths, self.poses(rows))


class SignalTrack(Track):
    """Vector ports as time series: rows (m,).

    Attributes:
        groups: entity path of each group of series → indices of its elements. Names that share the part
            before their last slash form a group.
        titles: title of the plot of each group, with its unit.
    """

    def __init__(self, key: str, spec: SignalSpec):
        ports = [spec.port] if isinstance(spec.port, OutputPort) else list(spec.port)
        super().__init__({f"{key}/{i}" if len(ports) > 1 else key: port for i, port in enumerate(ports)})
        n = len(spec.names)
        size = sum(_vector_size(key, port) for port in ports)
        if spec.derive is not None:
            shape = np.shape(spec.derive(np.zeros((1, size))))
            if shape != (1, n):
                raise ScenarioError(
                    f"recording of '{key}': derive makes {shape} of (1, {size}) values; expected (1, {n}), "
                    "one per name"
                )
        elif size != n:
            raise ScenarioError(f"recording of '{key}': {port_name(ports[0])} has size {size}, but {n} names")
        if spec.colors is not None and len(spec.colors) != n:
            raise ScenarioError(f"recording of '{key}': {n} names, but {len(spec.colors)} colors")
        self.spec = spec
        self.groups: dict[str, list[int]] = {}
        self.titles: dict[str, str] = {}
        unit = f" [{spec.unit}]" if spec.unit else ""
        for i, name in enumerate(spec.names):
            group = name.rpartition("/")[0]
            path = entity_path(key, group)
            self.groups.setdefault(path, []).append(i)
            self.titles[path] = (spec.title or group or key.partition("/")[0]) + unit

    def read(self, *values: np.ndarray) -> np.ndarray:
        return np.array(values[0]) if len(values) == 1 else np.concatenate(values)

    def write(self, writer: Writer, rows: Sequence[np.ndarray]) -> None:
        spec = self.spec
        values = np.array(rows, dtype=float)
        if spec.derive is not None and len(rows):
            values = spec.derive(values)
        values = values.reshape(len(rows), len(spec.names))
        for path, members in self.groups.items():
            # A joint has the same colour in every signal.
            colors = np.array([spec.colors[i] for i in members] if spec.colors else PALETTE)
            if spec.faint:
                colors = (colors + 255) // 2
            names = [f"{spec.names[i].rpartition('/')[2]} {spec.label}".strip() for i in members]
            writer.series(path, names, values[:, members], colors, 1.0 if spec.faint else 1.75)


class StateTrack(Track):
    """An integer code as a lane of named states: rows float."""

    def __init__(self, key: str, spec: StateSpec):
        super().__init__({key: spec.port})
        _vector_size(key, spec.port, 1)
        self.path = entity_path(key)
        self._labels = dict(spec.labels if isinstance(spec.labels, Mapping) else enumerate(spec.labels))

    def read(self, value: np.ndarray) -> float:
        return float(value[0])

    def write(self, writer: Writer, rows: Sequence[float]) -> None:
        writer.states(self.path, rows, self._labels)


class HandTrack(Track):
    """A human hand: rows (21, 3), p_WK, NaN while it is not tracked."""

    def __init__(self, key: str, spec: HandSpec):
        ports = {f"{key}/keypoints": spec.keypoints_port, f"{key}/wrist_pose": spec.wrist_pose_port}
        _vector_size(f"{key}/keypoints", spec.keypoints_port, 63)
        value: Any = spec.wrist_pose_port.Allocate()
        if not isinstance(value, Value[RigidTransform]):
            raise ScenarioError(
                f"recording of '{key}/wrist_pose': {port_name(spec.wrist_pose_port)} holds no RigidTransform"
            )
        if spec.valid_port is not None:
            _vector_size(f"{key}/valid", spec.valid_port, 1)
            ports[f"{key}/valid"] = spec.valid_port
        super().__init__(ports)
        self.key, self.path = key, entity_path(WORLD, key)
        self._color, self._X_WO = spec.color, spec.X_WO

    def read(
        self, keypoints: np.ndarray, X_OH: RigidTransform, valid: np.ndarray | None = None
    ) -> np.ndarray:
        if valid is not None and not valid[0] > 0.5:
            return np.full((21, 3), np.nan)
        return ((self._X_WO @ X_OH) @ keypoints.reshape(21, 3).T).T

    def write(self, writer: Writer, rows: Sequence[np.ndarray]) -> None:
        writer.human_hand(self.path, np.reshape(rows, (len(rows), 21, 3)), self._color)


class PointTrack(Track):
    """Points: rows of the port's values (m,), with X_WF (3, 4) if their frame F moves."""

    def __init__(self, key: str, spec: PointsSpec, body_poses: OutputPort):
        super().__init__({key: spec.port} | ({"body_poses": body_poses} if spec.frame is not None else {}))
        size = _vector_size(key, spec.port)
        if spec.derive is not None:
            size = np.size(spec.derive(np.zeros((1, size))))
        self._count = size // 3
        if not size or size % 3:
            raise ScenarioError(
                f"recording of '{key}': {port_name(spec.port)} gives {size} numbers, not 3 per point"
            )
        if np.ndim(spec.color) == 2 and len(spec.color) != self._count:
            raise ScenarioError(f"recording of '{key}': {self._count} points, but {len(spec.color)} colors")
        self.path, self.trail = entity_path(WORLD, key), spec.trail
        self._spec = spec
        self._frame = None if spec.frame is None else body_and_pose(spec.frame)

    def read(
        self, value: np.ndarray, body_poses: Sequence[RigidTransform] | None = None
    ) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        if self._frame is None or body_poses is None:
            return np.array(value)
        body, X_BF = self._frame
        return np.array(value), (body_poses[body] @ X_BF).GetAsMatrix34()

    def _points(self, rows: Sequence) -> np.ndarray:
        """p_WP (T, k, 3), NaN where a point is missing."""
        if not len(rows):
            return np.empty((0, self._count, 3))
        values = np.array(rows if self._frame is None else [value for value, _ in rows])
        points = values if self._spec.derive is None else self._spec.derive(values)
        points = points.reshape(len(rows), self._count, 3)
        if self._frame is None:
            return points
        X_WF = np.array([X for _, X in rows])
        return points @ X_WF[:, :, :3].swapaxes(1, 2) + X_WF[:, None, :, 3]

    def write(self, writer: Writer, rows: Sequence) -> None:
        points = self._points(rows)
        drawn = np.isfinite(points).all(axis=2)
        drawn &= writer.times[:, None] >= self._spec.start - 1e-9
        color: Any = self._spec.color
        palette = np.atleast_2d(color)
        # A point keeps its colour when others are missing.
        colors: Any = [palette[mask] for mask in drawn] if len(palette) > 1 else palette[0]
        fill = SOLID if (palette[:, 3:] < 255).any() else None
        visible = [row[mask] for row, mask in zip(points, drawn, strict=True)]
        writer.points(self.path, visible, self._spec.radius, colors, fill)


class CameraTrack(Track):
    """Images of a Drake camera: rows (JPEG, X_WC), C the colour camera, z forward and y down."""

    large = True

    def __init__(self, key: str, spec: CameraSpec):
        ports = {
            f"{key}/color_image": spec.sensor.color_image_output_port(),
            f"{key}/body_pose": spec.sensor.body_pose_in_world_output_port(),
        }
        super().__init__(ports, spec.period)
        self.path = entity_path(WORLD, key)
        core = spec.sensor.default_color_render_camera().core()
        self._intrinsics = core.intrinsics()
        self._X_BC = core.sensor_pose_in_camera_body()

    def read(self, image: ImageRgba8U, X_WB: RigidTransform) -> tuple[bytes, np.ndarray]:
        file = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(image.data[..., :3])).save(file, "JPEG", quality=_JPEG_QUALITY)
        return file.getvalue(), (X_WB @ self._X_BC).GetAsMatrix34()

    def write(self, writer: Writer, rows: Sequence[tuple[bytes, np.ndarray] | None]) -> None:
        optics = self._intrinsics
        pinhole = rr.Pinhole(
            image_from_camera=optics.intrinsic_matrix(),
            resolution=[optics.width(), optics.height()],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=_IMAGE_DISTANCE,
        )
        writer.static(self.path, pinhole)
        X_WC = np.array([np.full((3, 4), np.nan) if row is None else row[1] for row in rows])
        writer.poses([self.path], X_WC.reshape(-1, 1, 3, 4))
        taken = np.array([i for i, row in enumerate(rows) if row is not None], dtype=int)
        images = [row[0] for row in rows if row is not None]
        columns = rr.EncodedImage.columns(blob=images, media_type=["image/jpeg"] * len(images))
        writer.columns(self.path, columns, taken)


class ContactTrack(Track):
    """Contact forces: rows of `contact_rows`."""

    ARROWS = f"/{WORLD}/contact/forces"
    SERIES = "/contact/force"

    def __init__(self, scene: Scene, port: OutputPort, spec: ContactSpec):
        super().__init__({"contact_results": port})
        self._scene = scene
        self._spec = spec
        self._groups: dict[str, list[int]] | None = None
        if spec.groups is not None:
            self._groups = {name: [int(b.index()) for b in bodies] for name, bodies in spec.groups.items()}

    def read(self, results: ContactResults) -> np.ndarray:
        return contact_rows(results, self._scene.body_of_geometry)

    def write(self, writer: Writer, rows: Sequence[np.ndarray]) -> None:
        writer.static(self.ARROWS, rr.Arrows3D.from_fields(colors=[_CONTACT_COLOR], radii=[0.0025]))
        contacts = np.concatenate([np.empty((0, 8)), *rows])
        counts = np.array([len(row) for row in rows], dtype=int)
        force = contacts[:, 5:]
        arrows = self._spec.metres_per_newton * force
        length = np.linalg.norm(arrows, axis=1, keepdims=True)
        arrows *= np.minimum(1.0, self._spec.max_length / np.maximum(length, 1e-12))
        # One of the two bodies usually hides one of the two arrows.
        columns = rr.Arrows3D.columns(
            origins=np.repeat(contacts[:, 2:5], 2, axis=0),
            vectors=np.stack([arrows, -arrows], axis=1).reshape(-1, 3),
        )
        writer.columns(self.ARROWS, columns.partition(2 * counts))
        bodies = contacts[:, :2].astype(int)
        sample = np.repeat(np.arange(len(rows)), counts)
        self._write_series(writer, bodies, np.linalg.norm(force, axis=1), sample)

    def _write_series(
        self, writer: Writer, bodies: np.ndarray, magnitude: np.ndarray, sample: np.ndarray
    ) -> None:
        """For each group, the sum of the magnitudes of the forces that act on it from outside, N.

        Without groups, every moving body is one, from its first contact on.
        """
        groups: dict[str, tuple[str, list[int]]] = writer.memory.setdefault(self.SERIES, {})
        if self._groups is not None:
            groups |= {entity_path(self.SERIES, name): (name, of) for name, of in self._groups.items()}
        else:
            touched = set(bodies.ravel())
            for i in self._scene.moving:
                if i in touched:
                    path = self._scene.paths[i].removeprefix(f"/{WORLD}")
                    groups.setdefault(self.SERIES + path, (path[1:], [i]))
        for number, (path, (name, members)) in enumerate(groups.items()):
            member = np.zeros(len(self._scene.paths), dtype=bool)
            member[members] = True
            A, B = member[bodies].T
            crossing = A != B
            force = np.bincount(sample[crossing], magnitude[crossing], minlength=len(writer.times))
            finger = FINGER_COLOURS.get(name)
            color = PALETTE[number % len(PALETTE)] if finger is None else rgb(finger)
            writer.series(path, [name], force[:, None], [color], 1.5)


def body_and_pose(frame: Frame) -> tuple[int, RigidTransform]:
    """Index of the body that carries a frame F, and X_BF."""
    return int(frame.body().index()), frame.GetFixedPoseInBodyFrame()


def _vector_size(key: str, port: OutputPort, expected: int | None = None) -> int:
    """The size of a vector port; raises ScenarioError if it differs from `expected`."""
    if port.get_data_type() != PortDataType.kVectorValued:
        raise ScenarioError(f"recording of '{key}': {port_name(port)} is abstract; expected a vector port")
    if expected is not None and port.size() != expected:
        raise ScenarioError(
            f"recording of '{key}': {port_name(port)} has size {port.size()}; expected {expected}"
        )
    return port.size()


def port_name(port: OutputPort) -> str:
    """A port and its system, for messages."""
    system: Any = port.get_system()
    return f"port '{port.get_name()}' of '{system.get_name()}'"
