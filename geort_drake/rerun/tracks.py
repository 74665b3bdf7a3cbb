"""What a recorder keeps at every sample, and how each kind becomes columns of a Rerun file.

A track's `read` turns the values of its input ports into one row; `write` sends rows, all at once or
batch by batch.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from pydrake.math import RigidTransform

from geort_drake.colours import Color
from geort_drake.rerun.scene import Scene, entity_path
from geort_drake.rerun.specs import Derive
from geort_drake.rerun.writer import Writer

# Matplotlib's "tab10", which stays apart for colour-blind readers too.
PALETTE: tuple[Color, ...] = (
    (31, 119, 180),
    (255, 127, 14),
    (44, 160, 44),
    (214, 39, 40),
    (148, 103, 189),
    (140, 86, 75),
    (227, 119, 194),
    (127, 127, 127),
    (188, 189, 34),
    (23, 190, 207),
)


class Track:
    """Rows sampled from the input ports named in `ports`, at most once per `period`, s.

    A row is None where the track was not due.

    Attributes:
        large: whether the ports' values are too large to keep many of them.
    """

    large = False

    def __init__(self, *ports: str, period: float = 0.0):
        self.ports = ports
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
        """One row of the values of the ports."""
        raise NotImplementedError

    def describe(self, writer: Writer) -> None:
        """Sends what does not change."""

    def write(self, writer: Writer, rows: Sequence) -> None:
        """Sends rows, one for each of the writer's times."""
        raise NotImplementedError


class PoseTrack(Track):
    """Poses of all moving bodies: rows (bodies, 3, 4), X_WB."""

    def __init__(self, scene: Scene):
        super().__init__("body_poses")
        self._paths = [scene.paths[i] for i in scene.moving]
        self._indices = list(scene.moving)

    def read(self, body_poses: Sequence[RigidTransform]) -> np.ndarray:
        return np.array([body_poses[i].GetAsMatrix34() for i in self._indices]).reshape(-1, 3, 4)

    def poses(self) -> np.ndarray:
        """X_WB (T, bodies, 3, 4) of the moving bodies, in plant order."""
        return np.array(self.rows).reshape(len(self.rows), len(self._indices), 3, 4)

    def write(self, writer: Writer, rows: Sequence[np.ndarray]) -> None:
        poses = np.array(rows).reshape(len(rows), len(self._indices), 3, 4)
        finite = np.isfinite(poses).all(axis=(2, 3))
        poses[~finite] = np.eye(3, 4)  # not drawn
        translations = poses[..., 3].astype(np.float32)
        rotations = quaternions(poses[..., :3]).astype(np.float32)
        for k, path in enumerate(self._paths):
            drawn = None if finite[:, k].all() else finite[:, k]
            chosen = slice(None) if drawn is None else drawn
            columns = rr.Transform3D.columns(
                translation=translations[chosen, k], quaternion=rotations[chosen, k]
            )
            writer.columns(path, columns, drawn)


def quaternions(R: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4), xyzw, of rotation matrices (..., 3, 3).

    For matrices that are valid, as all of Drake's are; `scipy.spatial.transform.Rotation` takes several
    times as long, most of it to see whether they are.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(R, (-2, -1), (0, 1))
    # Every row is the quaternion times four times one of its elements: the largest one is exact.
    rows = np.array(
        [
            [1 + xx - yy - zz, xy + yx, zx + xz, zy - yz],
            [xy + yx, 1 - xx + yy - zz, yz + zy, xz - zx],
            [zx + xz, yz + zy, 1 - xx - yy + zz, yx - xy],
            [zy - yz, xz - zx, yx - xy, 1 + xx + yy + zz],
        ]
    )
    largest = np.argmax(np.einsum("ii...->i...", rows), axis=0)
    q = np.take_along_axis(rows, largest[None, None], axis=0)[0]
    return np.moveaxis(q / np.linalg.norm(q, axis=0), 0, -1)


class SignalTrack(Track):
    """Vector ports as time series: rows (m,).

    Names that share what stands before their last slash form a group, which is one entity.

    Args:
        key: entity path of the groups.
        names, label, faint, title, unit, page, legend, limits, colors, derive: see `SignalSpec`.
        ports: names of the input ports; by default one that is called like the key.

    Attributes:
        groups: name of a group → indices of its elements.
    """

    def __init__(
        self,
        key: str,
        names: Sequence[str],
        label: str = "",
        faint: bool = False,
        *,
        title: str = "",
        unit: str = "",
        page: str = "",
        legend: bool = False,
        limits: tuple[float, float] | None = None,
        colors: Sequence[Color] | None = None,
        derive: Derive | None = None,
        ports: Sequence[str] = (),
    ):
        super().__init__(*(ports or [key]))
        self.key = key
        self.page, self.legend, self.limits = page, legend, limits
        self.groups: dict[str, list[int]] = {}
        for i, name in enumerate(names):
            self.groups.setdefault(name.rpartition("/")[0], []).append(i)
        self._labels = [f"{name.rpartition('/')[2]} {label}".strip() for name in names]
        self._title, self._unit = title, unit
        self._faint, self._colors, self._derive = faint, colors, derive

    def read(self, *values: np.ndarray) -> np.ndarray:
        return np.array(values[0]) if len(values) == 1 else np.concatenate(values)

    def path(self, group: str) -> str:
        return entity_path(self.key, group)

    def title(self, group: str) -> str:
        """Of the plot that shows a group, with its unit."""
        title = self._title or group or self.key.partition("/")[0]
        return f"{title} [{self._unit}]" if self._unit else title

    def describe(self, writer: Writer) -> None:
        for group, members in self.groups.items():
            # The same joint has the same colour in every signal.
            palette = [PALETTE[i % len(PALETTE)] for i in range(len(members))]
            colors = np.array([self._colors[i] for i in members] if self._colors else palette)
            style = rr.SeriesLines(
                names=[self._labels[i] for i in members],
                colors=(colors + 255) // 2 if self._faint else colors,
                widths=[1.0 if self._faint else 1.75] * len(members),
            )
            writer.static(self.path(group), style)

    def write(self, writer: Writer, rows: Sequence[np.ndarray]) -> None:
        values = np.array(rows, dtype=float)
        if self._derive is not None and len(rows):
            values = self._derive(values)
        values = values.reshape(len(rows), len(self._labels))
        for group, members in self.groups.items():
            writer.columns(self.path(group), scalars(values[:, members]))


def scalars(values: np.ndarray) -> rr.ComponentColumnList:
    """Columns of values (T, n): n series under one entity."""
    return rr.Scalars.columns(scalars=values.ravel()).partition([values.shape[1]] * len(values))


class StateTrack(Track):
    """An integer code as a lane of named states: rows int; only changes are written."""

    def __init__(
        self,
        key: str,
        labels: Mapping[int, str],
        colors: Sequence[Color] = PALETTE,
        port: str | None = None,
    ):
        super().__init__(port or key)
        self.key = key
        self._labels = dict(labels)
        self._colors = colors

    def read(self, value: np.ndarray) -> float:
        return float(value[0])

    def _name(self, code: float) -> str:
        return self._labels.get(int(code), f"code {code:g}") if np.isfinite(code) else "nan"

    def describe(self, writer: Writer) -> None:
        names = list(self._labels.values())
        colors = [self._colors[i % len(self._colors)] for i in range(len(names))]
        style = rr.StateConfiguration(values=names, labels=names, colors=colors)
        writer.static(entity_path(self.key), style)

    def write(self, writer: Writer, rows: Sequence[float]) -> None:
        path = entity_path(self.key)
        names = [self._name(code) for code in rows]
        before = [writer.memory.get(path), *names]
        begin = np.array([i for i, name in enumerate(names) if name != before[i]], dtype=int)
        writer.columns(path, rr.StateChange.columns(state=[names[i] for i in begin]), begin)
        writer.memory[path] = before[-1]
