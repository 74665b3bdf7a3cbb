"""Points of a Rerun recording."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
from pydrake.math import RigidTransform

from geort_drake.rerun.scene import WORLD, entity_path
from geort_drake.rerun.specs import PointsSpec
from geort_drake.rerun.tracks import Track
from geort_drake.rerun.writer import Writer


class PointTrack(Track):
    """Points: rows of the port's values (m,), and of X_WF (3, 4) where their frame F moves.

    Args:
        key: entity path, under /world.
        port: name of the input port.
        count: of the points.
        spec: the rest; its port and its frame are not kept.
        frame: index of the body that carries the points' frame F, and X_BF; None for the world.

    Attributes:
        trail: see `PointsSpec`.
    """

    def __init__(
        self, key: str, port: str, count: int, spec: PointsSpec, frame: tuple[int, RigidTransform] | None
    ):
        super().__init__(port, *(["body_poses"] if frame else []))
        self.path = entity_path(WORLD, key)
        self.trail = spec.trail
        self._count, self._radius, self._start = count, spec.radius, spec.start
        self._derive, self._frame = spec.derive, frame
        self._colors = np.atleast_2d(np.array(spec.color, dtype=np.uint8))
        # One sees through Rerun's ellipsoids, but not through its points.
        self._glass = bool((self._colors[:, 3:] < 255).any())

    def read(
        self, value: np.ndarray, body_poses: Sequence[RigidTransform] | None = None
    ) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        if self._frame is None or body_poses is None:
            return np.array(value)
        body, X_BF = self._frame
        return np.array(value), (body_poses[body] @ X_BF).GetAsMatrix34()

    def _points(self, rows: Sequence) -> np.ndarray:
        """p_WP (T, k, 3), NaN where there is none."""
        if not len(rows):
            return np.empty((0, self._count, 3))
        values = np.array(rows if self._frame is None else [value for value, _ in rows])
        points = values if self._derive is None else self._derive(values)
        points = points.reshape(len(rows), self._count, 3)
        if self._frame is None:
            return points
        X_WF = np.array([X for _, X in rows])
        return points @ X_WF[:, :, :3].swapaxes(1, 2) + X_WF[:, None, :, 3]

    def describe(self, writer: Writer) -> None:
        style: dict[str, Any] = {"colors": self._colors} if len(self._colors) == 1 else {}
        if self._glass:
            solid = rr.components.FillMode.Solid
            writer.static(self.path, rr.Ellipsoids3D.from_fields(fill_mode=solid, **style))
        else:
            writer.static(self.path, rr.Points3D.from_fields(radii=[self._radius], **style))

    def write(self, writer: Writer, rows: Sequence) -> None:
        points = self._points(rows)
        drawn = np.isfinite(points).all(axis=2)
        drawn &= writer.times[:, None] >= self._start - 1e-9
        points = points[drawn]
        shades: dict[str, Any] = {}
        if len(self._colors) > 1:
            # As many as are drawn, so that each keeps its own.
            shades["colors"] = np.broadcast_to(self._colors, (*drawn.shape, self._colors.shape[1]))[drawn]
        if self._glass:
            sizes = np.full_like(points, self._radius)
            columns = rr.Ellipsoids3D.columns(centers=points, half_sizes=sizes, **shades)
        else:
            columns = rr.Points3D.columns(positions=points, **shades)
        writer.columns(self.path, columns.partition(drawn.sum(axis=1)))
