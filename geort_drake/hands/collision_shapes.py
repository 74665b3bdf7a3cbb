"""Converts a hand's collision geometry to plain arrays, for training without Drake."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pydrake.geometry import (
    Box,
    CalcObb,
    CalcVolume,
    Capsule,
    Convex,
    Cylinder,
    GeometryId,
    Mesh,
    Role,
    Shape,
    Sphere,
)

from geort_drake.errors import HandError
from geort_drake.hands.hand import Hand
from geort_drake.hands.kinematics import CollisionShapes
from geort_drake.hands.links import joint_paths

# For corrections: random postures, and those of them in which a pair must be near.
POSTURES, NEAR_POSTURES = 600, 5
NEAR, FAR = 0.003, 0.02  # m; a pair is near up to the first distance, and is measured up to the second
QUANTILE = 1 / 3  # of the differences; the median misses twice as many collisions


def collision_shapes(hand: Hand) -> CollisionShapes:
    """Returns the boxes and spheres of a hand, and the pairs of them that must not touch.

    Boxes and spheres stay the same. A cylinder becomes a box of equal length and cross-sectional area, and a
    capsule such a box with spheres at both ends. A mesh becomes the box around its convex hull, scaled to the
    hull's volume; Drake's distances correct the gaps of its pairs. Pairs that Drake filters and pairs of
    fingertips are left out.

    Raises:
        HandError: the hand has a collision geometry of another kind.
    """
    plant, inspector = hand.plant, hand.scene_graph.model_inspector()
    context = plant.CreateDefaultContext()
    moving = list(hand.kinematics().uncoupled()[0].joint_names)
    paths = joint_paths(plant, hand.instance)
    joint, X_JS, half, radius, source = [], [], [], [], []
    for geometry in sorted(inspector.GetAllGeometryIds(Role.kProximity), key=lambda id: id.get_value()):
        body = plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
        if body.index() == plant.world_body().index():
            continue
        X_WS = plant.EvalBodyPoseInWorld(context, body).GetAsMatrix4() @ (
            inspector.GetPoseInFrame(geometry).GetAsMatrix4()
        )
        movers = [each for each in paths[body.index()] if each.name() in moving]
        if not movers:
            X_WJ = np.eye(4)  # the hand base is welded to the world
        else:
            X_WJ = movers[-1].frame_on_child().CalcPoseInWorld(context).GetAsMatrix4()
        for X_GS, half_edges, r in _parts(inspector.GetShape(geometry), inspector.GetName(geometry)):
            joint.append(moving.index(movers[-1].name()) if movers else -1)
            X_JS.append(np.linalg.inv(X_WJ) @ X_WS @ X_GS)
            half.append(half_edges)
            radius.append(r)
            source.append(geometry)
    pairs = []
    for i in range(len(source)):
        for j in range(i + 1, len(source)):
            a, b = source[i], source[j]
            if a == b or joint[i] == joint[j] or inspector.CollisionFiltered(a, b) or hand.are_tips(a, b):
                continue
            pairs.append((j, i) if radius[i] > 0 else (i, j))
    shapes = CollisionShapes(
        np.array(joint, dtype=int),
        np.array(X_JS).reshape(-1, 4, 4),
        np.array(half).reshape(-1, 3),
        np.array(radius),
        np.array(pairs, dtype=int).reshape(-1, 2),
    )
    is_mesh = np.array([isinstance(inspector.GetShape(geometry), Convex | Mesh) for geometry in source])
    if not (pairs and is_mesh.any()):
        return shapes
    return replace(shapes, correction=_corrections(hand, shapes, source, is_mesh))


def canonical_shapes(hand: Hand) -> CollisionShapes:
    """Returns the hand's collision shapes; a left hand's are mirrored as by `canonical_kinematics`.

    Raises:
        HandError: as `collision_shapes`.
    """
    shapes = collision_shapes(hand)
    return shapes.mirrored() if hand.description.side == "left" else shapes


def _corrections(
    hand: Hand, shapes: CollisionShapes, source: Sequence[GeometryId], is_mesh: np.ndarray
) -> np.ndarray:
    """Returns (P,) the difference, m, between Drake's distance and the gap of each pair with a mesh.

    It is exceeded in two thirds of the random postures in which the pair is near.

    Args:
        source: (S,) the geometry of each shape.
        is_mesh: (S,) whether it is a mesh.
    """
    # The parts of a geometry share its columns.
    columns: dict[frozenset[GeometryId], int] = {}
    column = np.array(
        [columns.setdefault(frozenset((source[a], source[b])), len(columns)) for a, b in shapes.pairs]
    )
    distances, gaps = np.full((2, POSTURES, len(columns)), FAR)
    context = hand.contact_context()
    kinematics, coupling = hand.kinematics().uncoupled()
    a, b = shapes.pairs.T
    samples = hand.sample(POSTURES)
    X_BJ = kinematics.joint_poses(samples @ coupling.T)
    X_BJ = np.concatenate([X_BJ, np.tile(np.eye(4), (POSTURES, 1, 1, 1))], axis=1)  # −1 is the base
    for row, q in enumerate(samples):
        for found in hand.query(q, context).ComputeSignedDistancePairwiseClosestPoints(FAR):
            number = columns.get(frozenset((found.id_A, found.id_B)))
            if number is not None:
                distances[row, number] = min(found.distance, FAR)
        X_BS = X_BJ[row, shapes.joint] @ shapes.X_JS
        gap = _box_gap(X_BS[a], X_BS[b], shapes.half[a], shapes.half[b]) - (
            shapes.radius[a] + shapes.radius[b]
        )
        np.minimum.at(gaps[row], column, gap)
    near = np.minimum(distances, gaps) < NEAR
    known = near.sum(0) >= NEAR_POSTURES
    correction = np.zeros(len(columns))
    difference = np.where(near, distances - gaps, np.nan)[:, known]
    correction[known] = np.nanquantile(difference, QUANTILE, axis=0)
    return np.where(is_mesh[shapes.pairs].any(1), correction[column], 0.0)


def _box_gap(X_BA: np.ndarray, X_BC: np.ndarray, a: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Returns (P,) the largest separation, m, of boxes A and C with half edges a and c (P, 3), m.

    Over face normals, products of edges, and the direction from A's nearest point to C's centre, as
    `CollisionGaps` does for training.
    """
    R_A, R_C, p_AC = X_BA[:, :3, :3], X_BC[:, :3, :3], X_BC[:, :3, 3] - X_BA[:, :3, 3]
    edges = np.cross(R_A[:, :, :, None], R_C[:, :, None, :], axis=1).reshape(len(a), 3, 9)
    t = np.einsum("pij,pi->pj", R_A, p_AC)
    outside = np.einsum("pij,pj->pi", R_A, t - np.clip(t, -a, a))
    axes = np.concatenate([R_A, R_C, edges, outside[:, :, None]], axis=2)
    length = np.linalg.norm(axes, axis=1)
    axes = axes / np.maximum(length, 1e-12)[:, None]
    extent = sum(
        np.einsum("pi,pik->pk", half, np.abs(np.einsum("pji,pjk->pik", R, axes)))
        for R, half in ((R_A, a), (R_C, c))
    )
    gap = np.abs(np.einsum("pi,pik->pk", p_AC, axes)) - extent
    return np.where(length > [*[0.0] * 6, *[np.sqrt(1e-3)] * 9, 1e-5], gap, -np.inf).max(axis=1)


def _parts(shape: Shape, name: str) -> list[tuple[np.ndarray, tuple[float, float, float], float]]:
    """Returns the boxes and spheres that replace a shape: poses in its frame, half edges, m, and radii, m."""
    if isinstance(shape, Box):
        return [(np.eye(4), tuple(0.5 * shape.size()), 0.0)]
    if isinstance(shape, Sphere):
        return [(np.eye(4), (0.0, 0.0, 0.0), shape.radius())]
    if isinstance(shape, Cylinder | Capsule):
        side, end = 0.5 * np.sqrt(np.pi) * shape.radius(), 0.5 * shape.length()
        parts = [(np.eye(4), (side, side, end), 0.0)]
        if isinstance(shape, Capsule):
            for z in (-end, end):
                X = np.eye(4)
                X[2, 3] = z
                parts.append((X, (0.0, 0.0, 0.0), shape.radius()))
        return parts
    if isinstance(shape, Convex | Mesh):
        box, volume = CalcObb(shape), CalcVolume(Convex(shape.source(), shape.scale3()))
        half = box.half_width()
        return [(box.pose().GetAsMatrix4(), tuple(half * np.cbrt(volume / (8.0 * half.prod()))), 0.0)]
    raise unsupported_shape(shape, name)


def unsupported_shape(shape: Shape, name: str) -> HandError:
    """Makes the error for collision geometry that is no box, sphere, cylinder, capsule or mesh."""
    return HandError(
        f"collision geometry '{name}' is a {type(shape).__name__}; "
        "choose one of: box, sphere, cylinder, capsule, mesh"
    )
