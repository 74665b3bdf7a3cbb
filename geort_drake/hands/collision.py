"""Collision geometry of a hand: as plain arrays for training, and its gaps for a control loop.

Drake detects overlaps several times faster than it computes distances. For the gaps, every geometry is
therefore enlarged by half of the clearance: if two enlarged geometries do not overlap, the true ones keep it.
Enlarged boxes and hulls keep sharp edges and corners, so a computed gap may be less than the true distance,
but never more.
"""

from collections.abc import Sequence
from itertools import product
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    CalcObb,
    Capsule,
    CollisionFilterDeclaration,
    Convex,
    Cylinder,
    GeometryId,
    GeometrySet,
    InMemoryMesh,
    Mesh,
    Shape,
    Sphere,
)
from pydrake.systems.framework import Context

from geort_drake.errors import HandError
from geort_drake.hands.assembly import joint_paths
from geort_drake.hands.geometry import hull_vertices
from geort_drake.hands.hand import Hand
from geort_drake.hands.kinematics import CollisionShapes, lattice_directions

# Pairs whose distance depends on at most _GRID_JOINTS joints are checked at _GRID_SIZE angles of each.
_GRID_JOINTS, _GRID_SIZE = 2, 13
_CUBE = np.array(list(product((-1.0, 1.0), repeat=3)))  # corners (8, 3)
_NEXT_AXIS, _PREVIOUS_AXIS = np.array([1, 2, 0]), np.array([2, 0, 1])


class Near(NamedTuple):
    """K ≥ 0 pairs of geometries that are near each other.

    Attributes:
        pairs: K pairs of geometries.
        gap: (K,) lower bounds of the distances, m; negative where geometries may overlap.
        gradient: (K, n) gradients of the gaps with respect to q, m/rad; approximate between two edges.
    """

    pairs: list[tuple[GeometryId, GeometryId]]
    gap: np.ndarray
    gradient: np.ndarray


class HandClearance:
    """Computes the gaps between pairs of a hand's collision geometries that must keep a clearance.

    Pairs that Drake filters and pairs of fingertips are left out. Pairs within a finger, or of a finger and
    the palm, with at most two joints between them are also left out if they never touch on a grid over the
    ranges of these joints: joint limits keep them apart. A mesh counts as its convex hull.

    Not thread-safe: the object owns the contexts in which it computes.

    Attributes:
        pairs: the pairs that are checked.

    Args:
        hand: model of the hand.
        clearance: distance to keep, m.
        joints: names of the n joints in the order of q; by default `hand.joint_names`.

    Raises:
        HandError: the hand has collision geometry other than boxes, spheres, cylinders, capsules and meshes.
    """

    def __init__(self, hand: Hand, clearance: float, joints: Sequence[str] | None = None):
        self._hand, self._clearance = hand, clearance
        self._plant, self._inspector = hand.plant, hand.scene_graph.model_inspector()
        # The joints of q and their followers.
        self._names = [*hand.joint_names, *hand.couplings.names]
        order = list(joints or hand.joint_names)
        self._to_hand = np.array([order.index(name) for name in hand.joint_names])
        coupling = np.vstack([np.eye(len(order)), hand.couplings.ratio])
        self._coupling = coupling[:, np.argsort(self._to_hand)]
        self._read_chains()
        self.pairs = self._pairs()
        self._root = self._enlarge_hand()
        self._context = self._plant.GetMyContextFromRoot(self._root)

    def near(self, q: np.ndarray, count: int | None = None) -> Near:
        """Returns the pairs, or the nearest `count`, with gaps below the clearance at joint angles q (n,)."""
        penetrations = self._hand.query(q[self._to_hand], self._root).ComputePointPairPenetration()
        if not penetrations:
            return Near([], np.empty(0), np.empty((0, len(q))))
        if count is not None and len(penetrations) > count:
            penetrations = sorted(penetrations, key=attrgetter("depth"), reverse=True)[:count]
        pairs = [(pair.id_A, pair.id_B) for pair in penetrations]
        gap = np.array([self._clearance - pair.depth for pair in penetrations])
        n, x = np.concatenate(
            [pair.nhat_BA_W for pair in penetrations] + [pair.p_WCa for pair in penetrations]
        ).reshape(2, -1, 3)
        first, second = self._rows(pairs)
        # n · (ω × (x - o)) = ω · (x × n) + n · (o × ω)
        along = np.concatenate([_cross(x, n), n], axis=1) @ self._joint_axes()
        return Near(pairs, gap, (self._between(first, second) * along) @ self._coupling)

    def joints_between(self, pairs: Sequence[tuple[GeometryId, GeometryId]]) -> np.ndarray:
        """Returns (K, n) bool: the joints of q on which the gaps of K pairs depend."""
        return self._between(*self._rows(pairs)) @ self._coupling != 0

    def _rows(self, pairs: Sequence[tuple[GeometryId, GeometryId]]) -> tuple[list[int], list[int]]:
        """Returns the row numbers of the first and of the second geometry of each pair."""
        row = self._row
        return [row[id.get_value()] for id, _ in pairs], [row[id.get_value()] for _, id in pairs]

    def _between(self, first: Sequence[int], second: Sequence[int]) -> np.ndarray:
        """Returns (K, N): 1 if a joint moves only the first geometry, −1 if only the second, else 0."""
        return self._moves.take(first, 0) - self._moves.take(second, 0)

    def _read_chains(self) -> None:
        """Finds which joints move which geometry, and the joints' axes in their links."""
        names, plant = self._names, self._plant
        paths = joint_paths(plant, self._hand.instance)
        self._geometries = self._hand.collision_geometries()
        # The keys are integers, because hashing an identifier takes longer.
        self._row = {geometry.get_value(): row for row, geometry in enumerate(self._geometries)}
        links = map(plant.GetBodyFromFrameId, map(self._inspector.GetFrameId, self._geometries))
        movers = [{joint.name() for joint in paths[link.index()]} for link in links]
        self._moves = np.array([[name in path for name in names] for path in movers], dtype=int)
        joints = [plant.GetJointByName(name, self._hand.instance) for name in names]
        frames = [joint.frame_on_child().GetFixedPoseInBodyFrame() for joint in joints]
        self._links = [joint.child_body() for joint in joints]
        self._p_LJ = np.array([X_LJ.translation() for X_LJ in frames])[..., None]
        axes = [X_LJ.rotation() @ j.revolute_axis() for X_LJ, j in zip(frames, joints, strict=True)]
        self._axis_L = np.array(axes)[..., None]

    def _joint_axes(self) -> np.ndarray:
        """Returns (6, N): the joints' axes ω and below them o × ω of their origins o, m, in the world."""
        pose = self._plant.EvalBodyPoseInWorld
        X_WL = np.array([pose(self._context, link).GetAsMatrix34() for link in self._links])
        axis = (X_WL[:, :, :3] @ self._axis_L)[..., 0]
        origin = (X_WL[:, :, :3] @ self._p_LJ)[..., 0] + X_WL[:, :, 3]
        return np.concatenate([axis, _cross(origin, axis)], axis=1).T

    def _pairs(self) -> list[tuple[GeometryId, GeometryId]]:
        root = self._hand.contact_context()
        pairs: list[tuple[GeometryId, GeometryId]] = []
        by_joints: dict[tuple[int, ...], list[tuple[GeometryId, GeometryId]]] = {}
        for pair in self._candidates(root):
            if not self._row.keys() >= {geometry.get_value() for geometry in pair}:  # a floor, for example
                continue
            first, second = (self._moves[self._row[geometry.get_value()]] for geometry in pair)
            between = self._coupling[first != second].any(axis=0)[self._to_hand]
            one_chain = (first <= second).all() or (first >= second).all()
            if one_chain and between.sum() <= _GRID_JOINTS:
                by_joints.setdefault(tuple(np.flatnonzero(between)), []).append(pair)
            else:
                pairs.append(pair)
        for joints, neighbours in by_joints.items():
            if joints:
                touching = self._pairs_touching_on_grid(root, joints)
                pairs += [pair for pair in neighbours if frozenset(pair) in touching]
        return pairs

    def _candidates(self, root: Context) -> list[tuple[GeometryId, GeometryId]]:
        inspector = self._hand.query(self._hand.default_position, root).inspector()
        return sorted(inspector.GetCollisionCandidates(), key=lambda pair: [id.get_value() for id in pair])

    def _pairs_touching_on_grid(self, root: Context, joints: Sequence[int]) -> set[frozenset[GeometryId]]:
        """Finds pairs that touch on a grid over the ranges of the joints; others stay at their defaults."""
        grids = [
            np.linspace(self._hand.lower[joint], self._hand.upper[joint], _GRID_SIZE) for joint in joints
        ]
        pairs: set[frozenset[GeometryId]] = set()
        q = self._hand.default_position
        for angles in product(*grids):
            q[list(joints)] = angles
            touching = self._hand.query(q, root).ComputePointPairPenetration()
            pairs.update(frozenset((pair.id_A, pair.id_B)) for pair in touching)
        return pairs

    def _enlarge_hand(self) -> Context:
        """Creates a context in which all geometries are enlarged by half of the clearance."""
        root, scene_graph = self._hand.contact_context(), self._hand.scene_graph
        context = scene_graph.GetMyMutableContextFromRoot(root)
        for geometry in self._geometries:
            shape, name = self._inspector.GetShape(geometry), self._inspector.GetName(geometry)
            larger = _enlarge(shape, name, 0.5 * self._clearance)
            scene_graph.ChangeShape(context, self._plant.get_source_id(), geometry, larger)
        # Last, because a changed shape loses its collision filters.
        filters, checked_pairs = (
            scene_graph.collision_filter_manager(context),
            {frozenset(p) for p in self.pairs},
        )
        for pair in self._candidates(root):
            if frozenset(pair) not in checked_pairs:
                first, second = map(GeometrySet, pair)
                filters.Apply(CollisionFilterDeclaration().ExcludeBetween(first, second))
        return root


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Computes the cross products of the rows of a and b (K, 3); faster than `np.cross` for few rows."""
    return a.take(_NEXT_AXIS, 1) * b.take(_PREVIOUS_AXIS, 1) - a.take(_PREVIOUS_AXIS, 1) * b.take(
        _NEXT_AXIS, 1
    )


def _enlarge(shape: Shape, name: str, margin: float) -> Shape:
    """Returns a shape that contains all points within `margin`, m, of the given shape."""
    if isinstance(shape, Box):
        return Box(shape.size() + 2.0 * margin)
    if isinstance(shape, Sphere):
        return Sphere(shape.radius() + margin)
    if isinstance(shape, Cylinder):
        return Cylinder(shape.radius() + margin, shape.length() + 2.0 * margin)
    if isinstance(shape, Capsule):
        return Capsule(shape.radius() + margin, shape.length())
    if isinstance(shape, Convex | Mesh):
        return _enlarge_hull(shape, margin)
    raise unsupported_shape(shape, name)


def _enlarge_hull(shape: Convex | Mesh, margin: float) -> Convex:
    """Returns the Minkowski sum of a mesh's convex hull and a cube with half edge `margin`, m."""
    points = (hull_vertices(shape)[:, None] + margin * _CUBE).reshape(-1, 3)
    text = "".join(f"v {x:.9f} {y:.9f} {z:.9f}\n" for x, y, z in points)
    return Convex(InMemoryMesh(mesh_file=MemoryFile(text, ".obj", "enlarged hull")))


_CYLINDER_SIDES = 12


def collision_shapes(hand: Hand) -> CollisionShapes:
    """Returns the convex shapes of a hand, and the pairs of them that must not touch.

    A left hand's are mirrored, to be those of a hand with the kinematics `HandKinematics.mirrored()`.

    Boxes, spheres and capsules stay the same. A cylinder becomes a prism of equal cross-sectional area. Of a
    mesh's convex hull, those vertices are kept that lie outermost in the `lattice_directions` of its oriented
    bounding box. Pairs that Drake filters and pairs of fingertips are left out.

    Raises:
        HandError: the hand has a collision geometry of another kind.
    """
    plant, inspector = hand.plant, hand.scene_graph.model_inspector()
    context = plant.CreateDefaultContext()
    moving = list(hand.kinematics().uncoupled()[0].joint_names)
    paths = joint_paths(plant, hand.instance)
    joint, X_JS, vertices, radius = [], [], [], []
    source = sorted(hand.collision_geometries(), key=lambda id: id.get_value())
    for geometry in source:
        body = plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
        X_WG = plant.EvalBodyPoseInWorld(context, body).GetAsMatrix4() @ (
            inspector.GetPoseInFrame(geometry).GetAsMatrix4()
        )
        movers = [each for each in paths[body.index()] if each.name() in moving]
        if not movers:
            X_WJ = np.eye(4)  # the hand base is welded to the world
        else:
            X_WJ = movers[-1].frame_on_child().CalcPoseInWorld(context).GetAsMatrix4()
        X_GS, points, r = _hull(inspector.GetShape(geometry), inspector.GetName(geometry))
        joint.append(moving.index(movers[-1].name()) if movers else -1)
        X_JS.append(np.linalg.inv(X_WJ) @ X_WG @ X_GS)
        vertices.append(points)
        radius.append(r)
    pairs = [
        (i, j)
        for i, a in enumerate(source)
        for j, b in enumerate(source[:i])
        if joint[i] != joint[j] and not inspector.CollisionFiltered(a, b) and not hand.are_tips(a, b)
    ]
    most = max(map(len, vertices), default=1)
    y = -1.0 if hand.description.side == "left" else 1.0
    M = np.diag([1.0, y, 1.0, 1.0])
    return CollisionShapes(
        np.array(joint, dtype=int),
        M @ np.array(X_JS).reshape(-1, 4, 4) @ M,
        np.array([np.resize(points, (most, 3)) for points in vertices]).reshape(-1, most, 3) * [1.0, y, 1.0],
        np.array(radius),
        np.array(pairs, dtype=int).reshape(-1, 2),
    )


def _hull(shape: Shape, name: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Returns pose in the shape's frame, vertices, m, and radius, m, of a shape as in `CollisionShapes`."""
    X_GS = np.eye(4)
    if isinstance(shape, Box):
        return X_GS, 0.5 * shape.size() * _CUBE, 0.0
    if isinstance(shape, Sphere):
        return X_GS, np.zeros((1, 3)), shape.radius()
    if isinstance(shape, Capsule):
        return X_GS, 0.5 * shape.length() * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]), shape.radius()
    if isinstance(shape, Cylinder):
        angle = 2.0 * np.pi / _CYLINDER_SIDES
        radius = shape.radius() * np.sqrt(angle / np.sin(angle))
        turns = angle * np.arange(_CYLINDER_SIDES)
        ends = np.repeat([[-0.5 * shape.length()], [0.5 * shape.length()]], _CYLINDER_SIDES, axis=0)
        side = radius * np.column_stack([np.cos(turns), np.sin(turns)])
        return X_GS, np.hstack([np.tile(side, (2, 1)), ends]), 0.0
    if isinstance(shape, Convex | Mesh):
        X_GS = CalcObb(shape).pose().GetAsMatrix4()
        points = (hull_vertices(shape) - X_GS[:3, 3]) @ X_GS[:3, :3]
        return X_GS, points[np.unique(np.argmax(points @ lattice_directions().T, axis=0))], 0.0
    raise unsupported_shape(shape, name)


def unsupported_shape(shape: Shape, name: str) -> HandError:
    """Makes the error for collision geometry that is no box, sphere, cylinder, capsule or mesh."""
    return HandError(
        f"collision geometry '{name}' is a {type(shape).__name__}; "
        "choose one of: box, sphere, cylinder, capsule, mesh"
    )
