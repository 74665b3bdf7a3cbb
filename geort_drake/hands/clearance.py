"""How far apart the parts of a hand are, one configuration at a time, fast enough for a control loop.

Every collision geometry is a box, a disc and a sphere added up (Minkowski), which describes boxes,
cylinders, capsules and spheres exactly; a mesh is the box around its convex hull. Two of them are apart by
at least the largest separation found over some axes (the separating-axis theorem: Gottschalk et al. 1996,
"OBBTree"): the boxes' face normals, their edge products, and the directions from each to the other's centre.
So a gap given here is never more than the true distance; where a round side faces an edge it may be less.

`retargeting.collision_geometry` shares no table with this: it takes rounded shapes for boxes of their volume,
where a bound must hold here, and works on float32 batches of few pairs, where one pose must be quick here.
"""

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Box, CalcObb, Capsule, Convex, Cylinder, GeometryId, Mesh, Role, Shape, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.tree import RigidBody

from geort_drake.errors import HandError
from geort_drake.hands.links import inboard_joints, moving_joint
from geort_drake.hands.model import HandModel

# Pairs whose distance depends on so few joints are tried on a grid of this many angles per joint.
_FEW, _GRID = 2, 13


@dataclass(frozen=True)
class Near:
    """Pairs of geometries that are closer than was asked for: K of them.

    Attributes:
        rows: (K,) numbers of the pairs in `HandClearance.pairs`.
        gap: (K,) lower bound of the distance, m; negative where they may overlap.
        gradient: (K, n) of the gap with respect to q, m/rad; between two edges it is approximate.
        joints: (K, n) which joints the gap depends on.
    """

    rows: np.ndarray
    gap: np.ndarray
    gradient: np.ndarray
    joints: np.ndarray


class HandClearance:
    """Gaps between the parts of a hand that must not touch.

    Left out are pairs that Drake filters, pairs of two fingers' tips, and pairs of one finger, or of it and
    the palm, with at most two joints between them that touch at no angles of a grid over these joints'
    ranges: what lies so close along a finger was built so, and is kept apart by the joint limits.

    Raises:
        HandError: the hand has collision geometry other than boxes, spheres, cylinders, capsules and meshes.
    """

    def __init__(self, hand: HandModel):
        self._read_joints(hand)
        self._read_shapes(hand)
        pairs = self._pairs(hand)
        self._set_pairs(pairs)
        first, second = self._moves[pairs[:, 0]], self._moves[pairs[:, 1]]
        between = first ^ second
        one_chain = ((first & second == first) | (first & second == second)).all(axis=1)
        built_close = np.zeros(len(pairs), dtype=bool)
        for joints in np.unique(between[one_chain & (between.sum(axis=1) <= _FEW)], axis=0):
            rows = np.flatnonzero(one_chain & (between == joints).all(axis=1))
            self._set_pairs(pairs[rows])
            built_close[rows] = self._never_touch(np.flatnonzero(joints))
        self._set_pairs(pairs[~built_close])

    @property
    def pairs(self) -> list[tuple[GeometryId, GeometryId]]:
        """The pairs of collision geometries that are looked at."""
        return [(self._ids[i], self._ids[j]) for i, j in zip(self._a, self._b, strict=True)]

    def links(self, row: int) -> tuple[str, str]:
        """Names of the links that the geometries of a pair belong to."""
        return self._links[self._a[row]], self._links[self._b[row]]

    def near(self, q: np.ndarray, clearance: float, within: float) -> Near | None:
        """The pairs with a gap below `within` at joint positions q (n,), rad; lengths in m.

        None where every gap is at least `clearance`, which `within` is no less than.
        """
        T = self._joint_frames(q if self._coupling is None else self._coupling @ q)
        S = T[self._frame] @ self._X_JS
        R, p = S[:, :3, :3], S[:, :3, 3]
        row, gap, axis, side = self._gaps(R, p, within)
        if not (gap < clearance).any():
            return None
        a, b = self._a[row], self._b[row]
        # The axis as a unit vector from the first to the second, and a point where they face each other:
        # of the second where the axis is fixed in the first, and the other way round.
        n = (R[a] @ axis[:, :, None])[:, :, 0]
        n *= np.where(((p[b] - p[a]) * n).sum(axis=1) < 0, -1.0, 1.0)[:, None]
        x_A, x_B = self._facing(a, R[a], p[a], n), self._facing(b, R[b], p[b], -n)
        x = x_B + side[:, None] * (x_A - x_B)
        turn, origin = (T[:-1, :3, :3] @ self._axes)[:, :, 0], T[:-1, :3, 3]
        # n · (ω × (x − o)) = ω · (x × n) + n · (o × ω) for each joint's axis ω through o.
        along = _cross(x, n) @ turn.T + n @ _cross(origin, turn).T
        between = self._between[row]
        gradient, joints = between * along[:, self._place], between != 0
        if self._coupling is not None:
            gradient, joints = gradient @ self._coupling, joints @ (self._coupling != 0)
        return Near(row, gap, gradient, joints)

    def _read_joints(self, hand: HandModel) -> None:
        """The tree of joints, level by level from the base."""
        plant = hand.plant
        free, coupling = hand.kinematics().uncoupled()
        self._lower, self._upper, self._default = free.lower, free.upper, hand.default_position @ coupling.T
        # What the joints that follow others are turned by; nothing where there are none.
        self._coupling = coupling if len(coupling) > len(hand.joint_names) else None
        names = self._names = list(free.joint_names)
        self._inboard = inboard_joints(plant)
        context, joints = plant.CreateDefaultContext(), [plant.GetJointByName(name) for name in names]
        offsets = dict(zip(hand.couplings.names, hand.couplings.offset, strict=True))
        for joint in joints:
            joint.set_angle(context, offsets.get(joint.name(), 0.0))
        X_BJ = [joint.frame_on_child().CalcPoseInWorld(context).GetAsMatrix4() for joint in joints]
        self._above = above = [self._mover(joint.parent_body(), names) for joint in joints]
        depth = [0] * len(names)
        for j in range(len(names)):
            k = above[j]
            while k >= 0:
                depth[j], k = depth[j] + 1, above[k]
        order = np.argsort(depth, kind="stable")
        self._order = order
        self._place = place = np.argsort(order)  # of joint j among the frames; the base is the last frame
        self._levels = []
        for level in range(max(depth) + 1):
            members = np.flatnonzero(np.array(depth)[order] == level)
            parents = np.array([place[above[j]] if above[j] >= 0 else len(names) for j in order[members]])
            self._levels.append((slice(members[0], members[-1] + 1), parents))
        X_PJ, K = np.empty((len(names), 4, 4)), np.zeros((len(names), 4, 4))
        self._axes = np.empty((len(names), 3, 1))
        for row, j in enumerate(order):
            X_PJ[row] = np.linalg.inv(X_BJ[above[j]]) @ X_BJ[j] if above[j] >= 0 else X_BJ[j]
            x, y, z = self._axes[row, :, 0] = joints[j].revolute_axis()
            K[row, :3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        self._eye = np.eye(4)
        # Rodrigues: X_PJ Rot(a, θ) = X_PJ + sin θ · X_PJ K + (1 − cos θ) · X_PJ K²
        self._X, self._XK, self._XKK = X_PJ, X_PJ @ K, X_PJ @ K @ K

    def _mover(self, body: RigidBody, names: list[str]) -> int:
        """Number of the joint of q that moves a body, −1 for the base."""
        joint = moving_joint(body, self._inboard, names)
        return -1 if joint is None else names.index(joint.name())

    def _read_shapes(self, hand: HandModel) -> None:
        plant, inspector = hand.plant, hand.scene_graph.model_inspector()
        context = plant.CreateDefaultContext()
        n = len(self._lower)
        scenery = set(plant.GetCollisionGeometriesForBody(plant.world_body()))
        ids = set(inspector.GetAllGeometryIds(Role.kProximity)) - scenery
        self._ids: list[GeometryId] = sorted(ids, key=lambda geometry: geometry.get_value())
        X_JS, mover, sizes = [], [], []
        self._links: list[str] = []
        for geometry in self._ids:
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
            self._links.append(body.name())
            mover.append(self._mover(body, self._names))
            X_GS, *size = _summands(inspector.GetShape(geometry), inspector.GetName(geometry))
            sizes.append(size)
            X_BS = plant.EvalBodyPoseInWorld(context, body) @ inspector.GetPoseInFrame(geometry) @ X_GS
            if mover[-1] >= 0:
                joint = plant.GetJointByName(self._names[mover[-1]])
                X_BS = joint.frame_on_child().CalcPoseInWorld(context).inverse() @ X_BS
            X_JS.append(X_BS.GetAsMatrix4())
        self._X_JS, self._half = np.array(X_JS), np.array([half for half, _, _ in sizes])
        self._disc, self._radius = np.array([s[1] for s in sizes]), np.array([s[2] for s in sizes])
        self._frame = np.array([self._place[j] if j >= 0 else n for j in mover])
        self._moves = np.zeros((len(mover), n), dtype=bool)
        for row, nearest in enumerate(mover):
            joint = nearest
            while joint >= 0:
                self._moves[row, joint] = True
                joint = self._above[joint]
        # Half lengths along the own axes, and of the sphere around it.
        self._extent = self._half + self._disc[:, None] * [1.0, 1.0, 0.0] + self._radius[:, None]
        self._reach = (
            np.hypot(np.hypot(self._half[:, 0], self._half[:, 1]) + self._disc, self._half[:, 2])
            + self._radius
        )

    def _pairs(self, hand: HandModel) -> np.ndarray:
        inspector = hand.scene_graph.model_inspector()
        pairs = [
            (i, j)
            for i, first in enumerate(self._ids)
            for j, second in enumerate(self._ids[:i])
            if self._frame[i] != self._frame[j]
            and not inspector.CollisionFiltered(first, second)
            and not hand.are_tips(first, second)
        ]
        return np.array(pairs, dtype=int).reshape(-1, 2)

    def _set_pairs(self, pairs: np.ndarray) -> None:
        self._a, self._b = pairs.T.copy()
        # 1 for a joint that moves the second of a pair against the first, −1 for the other way round.
        self._between = self._moves[self._b].astype(int) - self._moves[self._a]
        self._flat = self._a * len(self._ids) + self._b
        self._pair_reach = self._reach[self._a] + self._reach[self._b]

    def _never_touch(self, joints: np.ndarray) -> np.ndarray:
        """(P,) which of the pairs have a positive gap wherever the given joints are."""
        touched = np.zeros(len(self._a), dtype=bool)
        grids = [np.linspace(self._lower[j], self._upper[j], _GRID) for j in joints]
        angles = np.stack(np.meshgrid(*grids), axis=-1).reshape(-1, len(joints))
        q = np.tile(self._default, (len(angles), 1))
        q[:, joints] = angles
        for T in self._joint_frames(q):
            S = T[self._frame] @ self._X_JS
            touched[self._gaps(S[:, :3, :3], S[:, :3, 3], 0.0)[0]] = True
        return ~touched

    def _joint_frames(self, q: np.ndarray) -> np.ndarray:
        """(..., n + 1, 4, 4) poses of the joints' moving frames in B at q (..., n), and last B itself.

        They come level by level, those of joints at the base first.
        """
        theta = q[..., self._order, None, None]
        local = self._X + np.sin(theta) * self._XK + (1.0 - np.cos(theta)) * self._XKK
        T = np.empty((*q.shape[:-1], q.shape[-1] + 1, 4, 4))
        T[..., -1, :, :] = self._eye
        for rows, parents in self._levels:
            np.matmul(T.take(parents, axis=-3), local[..., rows, :, :], out=T[..., rows, :, :])
        return T

    def _gaps(
        self, R: np.ndarray, p: np.ndarray, within: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Rows of the K pairs with a gap below `within`; their gaps; and the axes along which they have them.

        These are (K, 3) in the first one's frame, and fixed in the first one (0), the second (1) or neither.
        """
        # Spheres around everything leave few pairs, the face normals fewer.
        square = np.square(p).sum(axis=1)
        distance = (square[:, None] + square - 2.0 * (p @ p.T)).take(self._flat)
        row = np.flatnonzero(distance < np.square(self._pair_reach + within))
        a, b = self._a[row], self._b[row]
        p_AB = (p[b] - p[a])[:, None]
        R_BA = R[b].transpose(0, 2, 1) @ R[a]
        t, s = (p_AB @ R[a])[:, 0], (p_AB @ R[b])[:, 0]
        faces_A = np.abs(t) - self._extent[a] - self._along(b, R_BA.transpose(0, 2, 1))
        faces_B = np.abs(s) - self._extent[b] - self._along(a, R_BA)
        faces = np.concatenate([faces_A, faces_B], axis=1)
        kept = np.flatnonzero(faces.max(axis=1) < within)
        if not len(kept):
            return kept, np.empty(0), np.empty((0, 3)), np.empty(0)
        row, a, b, R_BA, t, s, faces = (x[kept] for x in (row, a, b, R_BA, t, s, faces))
        R_AB = R_BA.transpose(0, 2, 1)
        # Products e_i × b_j of the edges, and the directions from each one's core to the other's centre.
        axes = np.zeros((len(row), 11, 3))
        for i, (up, down) in enumerate(((1, 2), (2, 0), (0, 1))):
            axes[:, 3 * i : 3 * i + 3, up] = -R_BA[:, :, down]
            axes[:, 3 * i : 3 * i + 3, down] = R_BA[:, :, up]
        axes[:, 9] = t - np.clip(t, -self._half[a], self._half[a])
        axes[:, 10] = (R_AB @ (s - np.clip(s, -self._half[b], self._half[b]))[:, :, None])[:, :, 0]
        length = np.sqrt(np.square(axes).sum(axis=2))
        usable = length > 1e-6
        axes /= np.where(usable, length, 1.0)[:, :, None]
        apart = np.abs(axes @ t[:, :, None])[:, :, 0]
        apart -= self._along(a, axes) + self._along(b, axes @ R_AB)
        gaps = np.concatenate([faces, np.where(usable, apart, -np.inf)], axis=1)
        best = gaps.argmax(axis=1)
        gap = gaps.max(axis=1)
        close = gap < within
        best = best[close]
        every = np.concatenate([np.broadcast_to(np.eye(3), R_BA.shape), R_BA, axes], axis=1)
        return row[close], gap[close], every[close, best], np.array([0, 0, 0, 1, 1, 1, *[0.5] * 11])[best]

    def _along(self, shape: np.ndarray, axes: np.ndarray) -> np.ndarray:
        """(K, M) half lengths of shapes (K,) along unit axes (K, M, 3) in their own frames, m."""
        box = (np.abs(axes) @ self._half[shape][:, :, None])[:, :, 0]
        disc = self._disc[shape][:, None] * np.hypot(axes[:, :, 0], axes[:, :, 1])
        return box + disc + self._radius[shape][:, None]

    def _facing(self, shape: np.ndarray, R: np.ndarray, p: np.ndarray, n: np.ndarray) -> np.ndarray:
        """(K, 3) the farthest point of each shape along n (K, 3), a middle one where there are many."""
        u = (n[:, None] @ R)[:, 0]
        corner = np.where(np.abs(u) > 1e-3, np.sign(u), 0.0) * self._half[shape]
        level = np.maximum(np.hypot(u[:, 0], u[:, 1]), 1e-9)
        corner[:, :2] += (self._disc[shape] / level)[:, None] * u[:, :2]
        return p + (R @ corner[:, :, None])[:, :, 0] + self._radius[shape][:, None] * n


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Row by row, (K, 3); `np.cross` takes twice as long for few rows."""
    up, down = [1, 2, 0], [2, 0, 1]
    return a[:, up] * b[:, down] - a[:, down] * b[:, up]


def _summands(shape: Shape, name: str) -> tuple[RigidTransform, tuple[float, float, float], float, float]:
    """Pose in the geometry's frame, half edges of the box, radii of the disc about z and of the sphere."""
    X_GS = RigidTransform()
    if isinstance(shape, Box):
        x, y, z = 0.5 * shape.size()
        return X_GS, (x, y, z), 0.0, 0.0
    if isinstance(shape, Sphere):
        return X_GS, (0.0, 0.0, 0.0), 0.0, shape.radius()
    if isinstance(shape, Cylinder):
        return X_GS, (0.0, 0.0, 0.5 * shape.length()), shape.radius(), 0.0
    if isinstance(shape, Capsule):
        return X_GS, (0.0, 0.0, 0.5 * shape.length()), 0.0, shape.radius()
    if isinstance(shape, Convex | Mesh):
        box = CalcObb(shape)
        return box.pose(), tuple(box.half_width()), 0.0, 0.0
    raise HandError(
        f"collision geometry '{name}' is a {type(shape).__name__}; "
        "choose one of: box, sphere, cylinder, capsule, mesh"
    )
