"""What a recorder records: each kind reads ports, and writes Rerun columns."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame, RigidBody
from pydrake.systems.framework import OutputPort

from geort_drake.colours import Color
from geort_drake.rerun.writer import PALETTE, SOLID, WORLD, Writer, entity_path, state_names

# Maps the values (T, m) of ports at T times to the recorded values (T, n).
Derive = Callable[[np.ndarray], np.ndarray]


class Spec:
    """A kind of recorded data; `key` is its entity path.

    The file's layout has views for the kinds of this package and their subclasses, such as a `StateSpec` that
    reads an abstract port; other data are only in the file.
    """

    def ports(self, key: str, plant_port: Callable[[str], OutputPort]) -> dict[str, OutputPort]:
        """Returns name of a recorder's input port → output port to read; `plant_port` gives the plant's."""
        raise NotImplementedError

    def read(self, *values: Any) -> Any:
        """Makes a row from the values of the ports, which it must copy.

        A row is an array, a number, a text, bytes, or a tuple of these.
        """
        raise NotImplementedError

    def write(self, writer: Writer, key: str, rows: Sequence) -> None:
        """Sends rows, one for each of the writer's times."""
        raise NotImplementedError

    def samples(self, key: str, rows: Sequence) -> dict[str, np.ndarray]:
        """Returns name of a column → values (T,) or (T, n), for a table of T samples; by default none."""
        return {}


@dataclass(frozen=True)
class SignalSpec(Spec):
    """Records a vector output port as time series, one per element.

    Attributes:
        port: port of any system of the diagram, or several ports, whose values are concatenated.
        names: name of each element. Elements with the same part before the last slash share a plot, such as
            "index/joint_0".
        label: added to each name in the plot, such as "command".
        faint: whether to draw thin and pale lines.
        title: title of the plot; by default the part of the names before the last slash. Signals with the
            same title and unit share a plot.
        unit: added to the title.
        page: name of the tab with the plot.
        limits: lowest and highest value of the plot; by default those of the data.
        colors: colour of each element; by default from a palette.
        derive: computes the elements (T, n) from the ports' values (T, m) when the recording is written.
    """

    port: OutputPort | Sequence[OutputPort]
    names: Sequence[str]
    label: str = ""
    faint: bool = False
    title: str = ""
    unit: str = ""
    page: str = ""
    limits: tuple[float, float] | None = None
    colors: Sequence[Color] | None = None
    derive: Derive | None = None

    def ports(self, key: str, plant_port: Callable[[str], OutputPort]) -> dict[str, OutputPort]:
        ports = [self.port] if isinstance(self.port, OutputPort) else list(self.port)
        return {f"{key}/{i}" if len(ports) > 1 else key: port for i, port in enumerate(ports)}

    def plots(self, key: str) -> dict[str, tuple[str, list[int]]]:
        """Returns entity path → title of the plot and indices of the elements, for each group of series."""
        plots: dict[str, tuple[str, list[int]]] = {}
        for i, name in enumerate(self.names):
            group = name.rpartition("/")[0]
            title = self.title or group or key.partition("/")[0]
            title += f" [{self.unit}]" if self.unit else ""
            plots.setdefault(entity_path(key, group), (title, []))[1].append(i)
        return plots

    def read(self, *values: np.ndarray) -> np.ndarray:
        return np.concatenate(values)

    def write(self, writer: Writer, key: str, rows: Sequence[np.ndarray]) -> None:
        values = _derive(self.derive, rows, len(self.names))
        for path, (_, members) in self.plots(key).items():
            # A joint has the same colour in every signal.
            colors = np.array([self.colors[i] for i in members] if self.colors else PALETTE)
            if self.faint:
                colors = (colors + 255) // 2
            names = [f"{self.names[i].rpartition('/')[2]} {self.label}".strip() for i in members]
            writer.series(path, names, values[:, members], colors, 1.0 if self.faint else 1.75)

    def samples(self, key: str, rows: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        values = _derive(self.derive, rows, len(self.names))
        return {column_name(key, name): values[:, i] for i, name in enumerate(self.names)}


@dataclass(frozen=True)
class StateSpec(Spec):
    """Records a port with an integer code as a lane of named states.

    Attributes:
        port: vector output port of size 1.
        labels: names of the codes 0, 1, ...
    """

    port: OutputPort
    labels: Sequence[str]

    def ports(self, key: str, plant_port: Callable[[str], OutputPort]) -> dict[str, OutputPort]:
        return {key: self.port}

    def read(self, value: np.ndarray) -> float:
        return float(value[0])

    def write(self, writer: Writer, key: str, rows: Sequence[float]) -> None:
        writer.states(entity_path(key), rows, self.labels)

    def samples(self, key: str, rows: Sequence[float]) -> dict[str, np.ndarray]:
        return {f"state.{column_name(key)}": np.array(state_names(rows, self.labels))}


@dataclass(frozen=True)
class HandSpec(Spec):
    """Records a human hand from a glove and a tracker, in rows p_WK (21, 3), m; NaN while it is lost.

    Attributes:
        keypoints_port: vector output port with p_HK (63), keypoint-major, m.
        wrist_pose_port: abstract `RigidTransform` output port with X_OH in the tracker's frame O.
        valid_port: vector output port of size 1; the hand is drawn if the value exceeds 0.5. None always
            draws it.
        X_WO: pose of the tracker's frame in the world.
    """

    keypoints_port: OutputPort
    wrist_pose_port: OutputPort
    valid_port: OutputPort | None = None
    X_WO: RigidTransform = field(default_factory=RigidTransform)

    def ports(self, key: str, plant_port: Callable[[str], OutputPort]) -> dict[str, OutputPort]:
        ports = {f"{key}/keypoints": self.keypoints_port, f"{key}/wrist_pose": self.wrist_pose_port}
        return ports if self.valid_port is None else ports | {f"{key}/valid": self.valid_port}

    def read(
        self, keypoints: np.ndarray, X_OH: RigidTransform, valid: np.ndarray | None = None
    ) -> np.ndarray:
        if valid is not None and not valid[0] > 0.5:
            return np.full((21, 3), np.nan)
        return ((self.X_WO @ X_OH) @ keypoints.reshape(21, 3).T).T

    def write(self, writer: Writer, key: str, rows: Sequence[np.ndarray]) -> None:
        writer.human_hand(entity_path(WORLD, key), np.reshape(rows, (len(rows), 21, 3)))


@dataclass(frozen=True)
class PointsSpec(Spec):
    """Records a vector output port of 3k coordinates as k points; points with a NaN are not drawn.

    Attributes:
        port: vector output port, point-major, m.
        frame: frame of the plant in which the coordinates are measured; by default the world.
        radius: radius of the points, m.
        color: colour of all points, or of each; an opacity below 255 draws translucent spheres.
        trail: duration of the past that is shown, s; `math.inf` shows all of it.
        start: time of the first valid value, s.
        derive: computes coordinates from the port's values; see `SignalSpec`.
    """

    port: OutputPort
    frame: Frame | None = None
    radius: float = 0.006
    color: Color | Sequence[Color] = (255, 80, 200)
    trail: float = 0.0
    start: float = 0.0
    derive: Derive | None = None

    def ports(self, key: str, plant_port: Callable[[str], OutputPort]) -> dict[str, OutputPort]:
        return {key: self.port} | ({} if self.frame is None else {"body_poses": plant_port("body_poses")})

    def read(
        self, value: np.ndarray, body_poses: Sequence[RigidTransform] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        body, X_BF = self._fixed_in
        X_WF = X_BF if body_poses is None else body_poses[body] @ X_BF
        return np.array(value), X_WF.GetAsMatrix34()

    @cached_property
    def _fixed_in(self) -> tuple[int, RigidTransform]:
        return (0, RigidTransform()) if self.frame is None else body_and_pose(self.frame)

    def write(self, writer: Writer, key: str, rows: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        values, X_WF = [value for value, _ in rows], np.reshape([X for _, X in rows], (-1, 3, 4))
        p_FP = _derive(self.derive, values, -1).reshape(len(rows), -1, 3) if rows else np.empty((0, 1, 3))
        p_WP = p_FP @ X_WF[:, :, :3].swapaxes(1, 2) + X_WF[:, None, :, 3]
        is_drawn = np.isfinite(p_WP).all(axis=2) & (writer.times[:, None] >= self.start - 1e-9)
        palette = np.atleast_2d(np.asarray(self.color))
        # A point keeps its colour when others are missing.
        colors: Any = [palette[mask] for mask in is_drawn] if len(palette) > 1 else palette[0]
        fill = SOLID if (palette[:, 3:] < 255).any() else None
        visible = [row[mask] for row, mask in zip(p_WP, is_drawn, strict=True)]
        writer.points(entity_path(WORLD, key), visible, self.radius, colors, fill)


@dataclass(frozen=True)
class CloseUpSpec:
    """An additional view of the scene that follows a frame.

    Attributes:
        follows: frame F of the plant; or the key of a human hand, which is then shown alone, with its wrist
            frame H as F.
        eye, target: eye point and target point in F, m. If F belongs to the plant, an eye that would be below
            the target at the end is mirrored at the target's height: a table would hide what is to be seen.
        see_through: bodies that are translucent in this view.
    """

    follows: Frame | str
    eye: Sequence[float] | np.ndarray
    target: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0)
    see_through: Sequence[RigidBody] = ()


def body_and_pose(frame: Frame) -> tuple[int, RigidTransform]:
    """Returns the index of the body that carries a frame F, and X_BF."""
    return int(frame.body().index()), frame.GetFixedPoseInBodyFrame()


def _derive(derive: Derive | None, rows: Sequence[np.ndarray], size: int) -> np.ndarray:
    """Returns the recorded values (T, n) of rows; does not call `derive` without rows."""
    values = np.array(rows, dtype=float)
    return (derive(values) if derive is not None and len(rows) else values).reshape(len(rows), size)


def column_name(*keys: str) -> str:
    """Returns the name of a table's column for entity paths."""
    return "/".join(keys).strip("/").replace("/", ".")
