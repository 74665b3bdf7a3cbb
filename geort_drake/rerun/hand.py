"""A human hand in a Rerun recording: bones as capsules, joints as spheres, a palm between the knuckles."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
from pydrake.math import RigidTransform

from geort_drake.colours import FINGER_COLOURS, Color, rgb
from geort_drake.people.keypoints import (
    BONES,
    INDEX_MCP,
    LITTLE_MCP,
    MIDDLE_MCP,
    RING_MCP,
    THUMB_CMC,
    TIP_KEYPOINT,
    WRIST,
    wrist_pose,
)
from geort_drake.rerun.scene import WORLD, entity_path
from geort_drake.rerun.tracks import Track, quaternions
from geort_drake.rerun.writer import Writer


class HandTrack(Track):
    """A human hand: rows (21, 3), p_WK, NaN while it is not tracked."""

    FRAME = "wrist"  # an entity without a shape, which views can follow
    # Radii of a middle-sized hand, m: metacarpals thin, as the palm covers them, and each phalanx
    # thinner than the one before it.
    _RADII = np.tile([0.007, 0.0085, 0.0075, 0.0065], 5)
    _PALM = np.array([WRIST, THUMB_CMC, INDEX_MCP, MIDDLE_MCP, RING_MCP, LITTLE_MCP])
    _PALM_TRIANGLES = ((0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5))

    def __init__(self, key: str, color: Color, X_WO: RigidTransform, ports: Sequence[str] = ()):
        super().__init__(*ports)
        self.key = key
        self._color = np.array(color)
        self._X_WO = X_WO

    def read(
        self, keypoints: np.ndarray, X_OH: RigidTransform, valid: np.ndarray | None = None
    ) -> np.ndarray:
        if valid is not None and not valid[0] > 0.5:
            return np.full((21, 3), np.nan)
        return ((self._X_WO @ X_OH) @ keypoints.reshape(21, 3).T).T

    def last_rotation(self) -> np.ndarray:
        """R_WH (3, 3) where the hand was tracked last; the identity before."""
        tracked = (row for row in reversed(self.rows) if np.isfinite(row).all())
        row = next(tracked, None)
        return np.eye(3) if row is None else wrist_pose(row)[0]

    def _paths(self) -> list[str]:
        return [entity_path(WORLD, self.key, name) for name in ("bones", "keypoints", "palm")]

    def describe(self, writer: Writer) -> None:
        bones, points, palm = self._paths()
        solid = rr.components.FillMode.Solid
        skin = rr.Capsules3D.from_fields(radii=self._RADII, colors=[self._color], fill_mode=solid)
        writer.static(bones, skin)
        # Joints stand out a little from the skin, and darker; tips have the colour of their finger.
        radii = np.r_[0.011, 1.08 * self._RADII.reshape(5, 4)[:, [1, 2, 3, 3]].ravel()]
        colors = np.tile((0.72 * self._color).astype(np.uint8), (21, 1))
        for finger, tip in TIP_KEYPOINT.items():
            colors[tip], radii[tip] = rgb(FINGER_COLOURS[finger]), 1.3 * radii[tip]
        writer.static(points, rr.Points3D.from_fields(radii=radii, colors=colors))
        # Rerun does not shade a mesh without normals, so its colour is what shading makes of skin.
        shaded = [*(0.8 * self._color).astype(int).tolist(), 255]
        faces = rr.Mesh3D.from_fields(triangle_indices=self._PALM_TRIANGLES, albedo_factor=shaded)
        writer.static(palm, faces)

    def write(self, writer: Writer, rows: Sequence[np.ndarray]) -> None:
        bones, points, palm = self._paths()
        p_WK = np.array(rows).reshape(-1, 21, 3)
        drawn = np.isfinite(p_WK).all(axis=(1, 2))
        p_WK = p_WK[drawn]
        parents, children = np.array(BONES).T
        along = p_WK[:, children] - p_WK[:, parents]
        lengths = np.linalg.norm(along, axis=2)
        # Where a hand is lost an empty entry takes it off the screen.
        count = drawn.astype(int)
        capsules = rr.Capsules3D.columns(
            lengths=lengths.ravel(),
            translations=p_WK[:, parents].reshape(-1, 3),
            quaternions=_turn_z_to(along.reshape(-1, 3)),
        )
        writer.columns(bones, capsules.partition(20 * count))
        positions = rr.Points3D.columns(positions=p_WK.reshape(-1, 3))
        writer.columns(points, positions.partition(21 * count))
        corners = rr.Mesh3D.columns(vertex_positions=p_WK[:, self._PALM].reshape(-1, 3))
        writer.columns(palm, corners.partition(len(self._PALM) * count))
        R_WH, p_WH = wrist_pose(p_WK)
        wrist = rr.Transform3D.columns(translation=p_WH, quaternion=quaternions(R_WH))
        writer.columns(entity_path(WORLD, self.key, self.FRAME), wrist, drawn)


def _turn_z_to(directions: np.ndarray) -> np.ndarray:
    """Shortest rotations (n, 4), xyzw, that turn the z axis to the directions (n, 3)."""
    length = np.maximum(np.linalg.norm(directions, axis=1), 1e-12)
    x, y, z = (directions / length[:, None]).T
    quaternions = np.stack([-y, x, np.zeros_like(x), 1 + z], axis=1)
    quaternions[z < -1 + 1e-9] = (1.0, 0.0, 0.0, 0.0)  # straight down: half a turn about x
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
