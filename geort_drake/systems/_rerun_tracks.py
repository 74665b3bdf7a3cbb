"""What a recorder keeps at every sample, and how each kind becomes columns of a Rerun file.

A track's `read` turns the values of its input ports into one row; `write` sends all rows at once.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ContactResults
from scipy.spatial.transform import Rotation

from geort_drake.gloves.keypoints import BONES, INDEX_MCP, LITTLE_MCP, MIDDLE_MCP, RING_MCP, THUMB_CMC, WRIST
from geort_drake.systems._rerun_scene import WORLD, Scene, entity_path

TIMELINE = "sim_time"
Color = tuple[int, int, int]

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
_CONTACT_COLOR: Color = (255, 200, 40)


class Writer:
    """Sends arrays to one recording stream, and fails instead of dropping what is malformed."""

    def __init__(self, stream: rr.RecordingStream, times: np.ndarray):
        self._stream = stream
        self._times = times

    def static(self, path: str, archetype: rr.AsComponents) -> None:
        self._stream.log(path, archetype, static=True, strict=True)

    def columns(self, path: str, columns: rr.ComponentColumnList, rows: np.ndarray | None = None) -> None:
        """Sends one entry per sample, or one per sample of which the mask or indices `rows` hold."""
        times = self._times if rows is None else self._times[rows]
        if len(times):
            index = rr.TimeColumn(TIMELINE, duration=times)
            self._stream.send_columns(path, [index], columns, strict=True)


class Track:
    """Rows sampled from input ports that are named in `ports`."""

    def __init__(self, *ports: str):
        self.ports = ports
        self.rows: list = []

    def read(self, *values):
        raise NotImplementedError

    def write(self, writer: Writer) -> None:
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

    def write(self, writer: Writer) -> None:
        poses = self.poses()
        for k, path in enumerate(self._paths):
            X_WB = poses[:, k]
            finite = np.isfinite(X_WB).all(axis=(1, 2))
            X_WB = X_WB[finite]
            if len(X_WB):
                columns = rr.Transform3D.columns(
                    translation=X_WB[:, :, 3].astype(np.float32),
                    quaternion=Rotation.from_matrix(X_WB[:, :, :3]).as_quat().astype(np.float32),
                )
                writer.columns(path, columns, finite)


class ContactTrack(Track):
    """Contact forces: rows (contacts, 8), body A, body B, p_WC (m), f_Bc_W (N)."""

    ARROWS = f"/{WORLD}/contact/forces"
    SERIES = "/contact/force"

    def __init__(
        self,
        scene: Scene,
        groups: Mapping[str, Sequence[int]] | None,
        metres_per_newton: float,
        max_length: float,
    ):
        super().__init__("contact_results")
        self._scene = scene
        self._groups = groups
        self._scale = metres_per_newton
        self._max_length = max_length

    def read(self, results: ContactResults) -> np.ndarray:
        rows = []
        for i in range(results.num_point_pair_contacts()):
            point = results.point_pair_contact_info(i)
            bodies = [int(point.bodyA_index()), int(point.bodyB_index())]
            rows.append([*bodies, *point.contact_point(), *point.contact_force()])
        for i in range(results.num_hydroelastic_contacts()):
            patch = results.hydroelastic_contact_info(i)
            surface = patch.contact_surface()
            bodies = [self._scene.body_of_geometry[g] for g in (surface.id_M(), surface.id_N())]
            # F_Ac_W acts on the body of M, at the centroid.
            rows.append([*bodies, *surface.centroid(), *np.negative(patch.F_Ac_W().translational())])
        return np.array(rows, dtype=float).reshape(-1, 8)

    def series(self) -> dict[str, np.ndarray]:
        """For each group, the sum (T,) of the magnitudes of the forces that act on it from outside, N.

        Without groups, every body that moves and that was ever touched is its own.
        """
        rows = np.concatenate([np.empty((0, 8)), *self.rows])
        sample = np.repeat(np.arange(len(self.rows)), [len(row) for row in self.rows])
        magnitude = np.linalg.norm(rows[:, 5:], axis=1)
        groups = self._groups
        if groups is None:
            touched = sorted({int(i) for i in rows[:, :2].ravel()} & set(self._scene.moving))
            groups = {self._scene.paths[i].removeprefix(f"/{WORLD}/"): [i] for i in touched}
        series = {}
        for name, members in groups.items():
            inside = np.isin(rows[:, :2], list(members))
            crossing = inside[:, 0] != inside[:, 1]
            series[name] = np.bincount(sample[crossing], magnitude[crossing], minlength=len(self.rows))
        return series

    def write(self, writer: Writer) -> None:
        writer.static(self.ARROWS, rr.Arrows3D.from_fields(colors=[_CONTACT_COLOR], radii=[0.0025]))
        rows = np.concatenate([np.empty((0, 8)), *self.rows])
        length = self._scale * np.linalg.norm(rows[:, 5:], axis=1, keepdims=True)
        shrink = np.minimum(1.0, self._max_length / np.maximum(length, 1e-12))
        on_B = self._scale * shrink * rows[:, 5:]
        # Both of the pair are drawn: one of the two bodies usually hides the other arrow.
        columns = rr.Arrows3D.columns(
            origins=np.repeat(rows[:, 2:5], 2, axis=0),
            vectors=np.stack([on_B, -on_B], axis=1).reshape(-1, 3),
        )
        writer.columns(self.ARROWS, columns.partition([2 * len(row) for row in self.rows]))
        series = self.series()
        if series:
            colors = [PALETTE[i % len(PALETTE)] for i in range(len(series))]
            style = rr.SeriesLines(names=list(series), colors=colors, widths=[1.5] * len(series))
            writer.static(self.SERIES, style)
            writer.columns(self.SERIES, _scalars(np.stack(list(series.values()), axis=1)))


class SignalTrack(Track):
    """A vector port as time series: rows (n,).

    Names that share what stands before their last slash form a group, which is one entity.
    """

    def __init__(self, key: str, names: Sequence[str], label: str, faint: bool):
        super().__init__(key)
        self.key = key
        self.groups: dict[str, list[int]] = {}
        for i, name in enumerate(names):
            self.groups.setdefault(name.rpartition("/")[0], []).append(i)
        self._labels = [f"{name.rpartition('/')[2]} {label}".strip() for name in names]
        self._faint = faint

    def read(self, value: np.ndarray) -> np.ndarray:
        return np.array(value)

    def path(self, group: str) -> str:
        return entity_path(self.key, group)

    def write(self, writer: Writer) -> None:
        values = np.array(self.rows).reshape(-1, len(self._labels))
        for group, members in self.groups.items():
            # The same joint has the same colour in every signal.
            colors = np.array([PALETTE[i % len(PALETTE)] for i in range(len(members))])
            style = rr.SeriesLines(
                names=[self._labels[i] for i in members],
                colors=(colors + 255) // 2 if self._faint else colors,
                widths=[1.0 if self._faint else 1.75] * len(members),
            )
            writer.static(self.path(group), style)
            writer.columns(self.path(group), _scalars(values[:, members]))


def _scalars(values: np.ndarray) -> rr.ComponentColumnList:
    """Columns of values (T, n): n series under one entity."""
    return rr.Scalars.columns(scalars=values.ravel()).partition([values.shape[1]] * len(values))


class StateTrack(Track):
    """An integer code as a lane of named states: rows int; only changes are written."""

    def __init__(self, key: str, labels: Mapping[int, str]):
        super().__init__(key)
        self.key = key
        self._labels = dict(labels)

    def read(self, value: np.ndarray) -> float:
        return float(value[0])

    def changes(self) -> tuple[np.ndarray, list[str]]:
        """Indices of the samples at which the state changes, and the states that begin there."""
        codes = np.array(self.rows)
        begin = np.flatnonzero(np.r_[True, codes[1:] != codes[:-1]]) if len(codes) else np.empty(0, int)
        return begin, [self._name(codes[i]) for i in begin]

    def _name(self, code: float) -> str:
        return self._labels.get(int(code), f"code {code:g}") if np.isfinite(code) else "nan"

    def write(self, writer: Writer) -> None:
        path = entity_path(self.key)
        names = list(self._labels.values())
        colors = [PALETTE[i % len(PALETTE)] for i in range(len(names))]
        writer.static(path, rr.StateConfiguration(values=names, labels=names, colors=colors))
        begin, states = self.changes()
        writer.columns(path, rr.StateChange.columns(state=states), begin)


class HandTrack(Track):
    """A human hand: rows (21, 3), p_WK, NaN while it is not tracked."""

    # Radii of a middle-sized hand, m: metacarpals thin, as the palm covers them, and each phalanx
    # thinner than the one before it.
    _RADII = np.tile([0.007, 0.0085, 0.0075, 0.0065], 5)
    _PALM = np.array([WRIST, THUMB_CMC, INDEX_MCP, MIDDLE_MCP, RING_MCP, LITTLE_MCP])
    _PALM_TRIANGLES = ((0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5))

    def __init__(self, key: str, color: Color, X_WO: RigidTransform, has_valid: bool):
        super().__init__(f"{key}/keypoints", f"{key}/wrist_pose", *([f"{key}/valid"] * has_valid))
        self.key = key
        self._color = np.array(color)
        self._X_WO = X_WO

    def read(
        self, keypoints: np.ndarray, X_OH: RigidTransform, valid: np.ndarray | None = None
    ) -> np.ndarray:
        if valid is not None and not valid[0] > 0.5:
            return np.full((21, 3), np.nan)
        return ((self._X_WO @ X_OH) @ keypoints.reshape(21, 3).T).T

    def write(self, writer: Writer) -> None:
        p_WK = np.array(self.rows).reshape(-1, 21, 3)
        drawn = np.isfinite(p_WK).all(axis=(1, 2))
        p_WK = p_WK[drawn]
        bones, points, palm = (entity_path(WORLD, self.key, name) for name in ("bones", "keypoints", "palm"))
        solid = rr.components.FillMode.Solid
        skin = rr.Capsules3D.from_fields(radii=self._RADII, colors=[self._color], fill_mode=solid)
        writer.static(bones, skin)
        # Joints stand out a little from the skin, and darker.
        radii = np.r_[0.011, 1.08 * self._RADII.reshape(5, 4)[:, [1, 2, 3, 3]].ravel()]
        joints = rr.Points3D.from_fields(radii=radii, colors=[(0.72 * self._color).astype(np.uint8)])
        writer.static(points, joints)
        # Rerun does not shade a mesh without normals, so its colour is what shading makes of skin.
        shaded = [*(0.8 * self._color).astype(int).tolist(), 255]
        faces = rr.Mesh3D.from_fields(triangle_indices=self._PALM_TRIANGLES, albedo_factor=shaded)
        writer.static(palm, faces)

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


class PointTrack(Track):
    """Points: rows (k, 3), p_WP, NaN where there is none."""

    def __init__(self, key: str, radius: float, color: Color, frame: tuple[int, RigidTransform] | None):
        super().__init__(key, *(["body_poses"] if frame else []))
        self.key = key
        self._radius = radius
        self._color = color
        self._frame = frame

    def read(self, value: np.ndarray, body_poses: Sequence[RigidTransform] | None = None) -> np.ndarray:
        points = np.array(value).reshape(-1, 3)
        if self._frame is None or body_poses is None:
            return points
        body, X_BF = self._frame
        return ((body_poses[body] @ X_BF) @ points.T).T

    def write(self, writer: Writer) -> None:
        path = entity_path(WORLD, self.key)
        writer.static(path, rr.Points3D.from_fields(radii=[self._radius], colors=[self._color]))
        rows = [row[np.isfinite(row).all(axis=1)] for row in self.rows]
        columns = rr.Points3D.columns(positions=np.concatenate([np.empty((0, 3)), *rows]))
        writer.columns(path, columns.partition([len(row) for row in rows]))


def _turn_z_to(directions: np.ndarray) -> np.ndarray:
    """Shortest rotations (n, 4), xyzw, that turn the z axis to the directions (n, 3)."""
    length = np.maximum(np.linalg.norm(directions, axis=1), 1e-12)
    x, y, z = (directions / length[:, None]).T
    quaternions = np.stack([-y, x, np.zeros_like(x), 1 + z], axis=1)
    quaternions[z < -1 + 1e-9] = (1.0, 0.0, 0.0, 0.0)  # straight down: half a turn about x
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
