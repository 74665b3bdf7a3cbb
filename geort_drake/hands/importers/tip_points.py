"""Where a finger's tip is, from the geometry of its last link."""

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    GeometryId,
    Mesh,
    Role,
    SceneGraphInspector,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from geort_drake.hands.importers.structure import Chain, HandStructure

# A tip is looked for within this much of the last link's length from its end, and its radius is held to
# what fingers have, m.
_END = 0.25
_RADII = (0.003, 0.016)
# Without any geometry: this part of the length of the link before, and this radius, m.
_GUESSED_LENGTH, _GUESSED_RADIUS = 0.8, 0.008


@dataclass(frozen=True)
class TipPoint:
    """A fingertip point: the centre of the rounded end of a finger.

    Attributes:
        body: the link that carries it.
        point: (3,) in the link's frame, m.
        radius: of the sphere around it that touches things, m.
        source: what it was taken from.
    """

    body: RigidBody
    point: np.ndarray
    radius: float
    source: str


def tip_point(structure: HandStructure, chain: Chain) -> TipPoint:
    """The end of a finger: of its collision geometry, else of what is drawn, else guessed."""
    context = structure.plant.CreateDefaultContext()
    last = structure.plant.GetJointByName(chain.moving[-1], structure.hand)
    p_RJ = last.frame_on_child().CalcPoseInWorld(context).translation()
    for role, source in ((Role.kProximity, "collision geometry"), (Role.kIllustration, "visual geometry")):
        parts = _parts(structure, chain, role)
        if parts:
            return _end_of(structure, parts, p_RJ, source)
    # The joints' places alone.
    origins = [
        structure.plant.GetJointByName(name, structure.hand).frame_on_child().CalcPoseInWorld(context)
        for name in chain.moving
    ]
    along = next(
        (p_RJ - X.translation() for X in origins[::-1] if np.linalg.norm(p_RJ - X.translation()) > 1e-3),
        np.array([0.0, 0.0, 0.02]),
    )
    X_RB = structure.plant.EvalBodyPoseInWorld(context, chain.bodies[0])
    point = X_RB.inverse() @ (p_RJ + _GUESSED_LENGTH * along)
    return TipPoint(chain.bodies[0], point, _GUESSED_RADIUS, "nothing but the joints' places")


def _parts(structure: HandStructure, chain: Chain, role: Role) -> list:
    """Link, shape, pose in R and surface points (N, 3) in R of each geometry of the last link."""
    plant, inspector = structure.plant, structure.scene_graph.model_inspector()
    context = plant.CreateDefaultContext()
    parts = []
    for body in chain.bodies:
        X_RB = plant.EvalBodyPoseInWorld(context, body)
        for geometry in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(body.index()), role):
            points = surface_points(inspector, geometry)
            if points is not None:
                X_RG = X_RB @ inspector.GetPoseInFrame(geometry)
                parts.append((body, inspector.GetShape(geometry), X_RG, (X_RG @ points.T).T))
    return parts


def _end_of(structure: HandStructure, parts: list, p_RJ: np.ndarray, source: str) -> TipPoint:
    points = np.concatenate([points for *_, points in parts])
    distance = np.linalg.norm(points - p_RJ, axis=1)
    along = (points[distance.argmax()] - p_RJ) / distance.max()
    owner = np.repeat(np.arange(len(parts)), [len(points) for *_, points in parts])
    body, shape, X_RG, _ = parts[owner[distance.argmax()]]
    X_RB = structure.plant.EvalBodyPoseInWorld(structure.plant.CreateDefaultContext(), body)
    if isinstance(shape, Sphere | Capsule):
        end = np.array([0.0, 0.0, 0.5 * shape.length() if isinstance(shape, Capsule) else 0.0])
        ends = [X_RG @ end, X_RG @ -end]
        centre = max(ends, key=lambda p: float((p - p_RJ) @ along))
        return TipPoint(body, X_RB.inverse() @ centre, float(shape.radius()), f"a sphere of the {source}")
    depth = (points - p_RJ) @ along
    near = points[depth > (1 - _END) * depth.max()] - p_RJ
    across = near - np.outer(near @ along, along)
    _, _, axes = np.linalg.svd(across - across.mean(axis=0), full_matrices=False)
    low, high = (across @ axes[:2].T).min(axis=0), (across @ axes[:2].T).max(axis=0)
    radius = float(np.clip(0.5 * (high - low).min(), *_RADII))
    radius = min(radius, 0.5 * depth.max())
    centre = p_RJ + along * (depth.max() - radius) + axes[:2].T @ (0.5 * (low + high))
    return TipPoint(body, X_RB.inverse() @ centre, radius, f"the end of the {source}")


def surface_points(inspector: SceneGraphInspector, geometry: GeometryId) -> np.ndarray | None:
    """(N, 3) points on the outside of a geometry in its own frame, m; None if they cannot be had."""
    shape = inspector.GetShape(geometry)
    if isinstance(shape, Mesh | Convex):
        try:
            hull = shape.GetConvexHull()
        except RuntimeError:
            return None  # of a kind that Drake draws without reading it
        return np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    if isinstance(shape, Box):
        return 0.5 * signs * shape.size()
    if isinstance(shape, Cylinder):
        side = np.sqrt(0.5) * shape.radius()
        return signs * [side, side, 0.5 * shape.length()]
    ball = signs / np.sqrt(3)
    ball = np.concatenate([ball, np.eye(3), -np.eye(3)])
    if isinstance(shape, Sphere):
        return shape.radius() * ball
    if isinstance(shape, Capsule):
        ends = np.array([0.0, 0.0, 0.5 * shape.length()])
        return np.concatenate([shape.radius() * ball + ends, shape.radius() * ball - ends])
    if isinstance(shape, Ellipsoid):
        return ball * [shape.a(), shape.b(), shape.c()]
    return None


def link_points(
    plant: MultibodyPlant,
    inspector: SceneGraphInspector,
    link: RigidBody,
    role: Role,
    X_BL: RigidTransform,
) -> list[np.ndarray]:
    """Points (N, 3) on the outside of each of a link's geometries of a role, in a frame B, m."""
    points = []
    for geometry in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(link.index()), role):
        p_GP = surface_points(inspector, geometry)
        if p_GP is not None:
            points.append((X_BL @ inspector.GetPoseInFrame(geometry) @ p_GP.T).T)
    return points


def palm_points(structure: HandStructure, X_RB: RigidTransform) -> np.ndarray:
    """(N, 3) points of the palm's geometry in the hand base B, m; its links' origins where it has none."""
    plant, inspector = structure.plant, structure.scene_graph.model_inspector()
    context = plant.CreateDefaultContext()
    for role in (Role.kProximity, Role.kIllustration):
        found = []
        for body in structure.palm:
            X_BL = X_RB.inverse() @ plant.EvalBodyPoseInWorld(context, body)
            found += link_points(plant, inspector, body, role, X_BL)
        if found:
            return np.concatenate(found)
    origins = [X_RB.inverse() @ plant.EvalBodyPoseInWorld(context, b).translation() for b in structure.palm]
    return np.array(origins)
