"""Finds the fingertip on the geometry of a finger's last link."""

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import (
    CalcObb,
    Capsule,
    Convex,
    GeometryId,
    Mesh,
    Role,
    SceneGraphInspector,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from geort_drake.hands.importers.structure import Chain, HandStructure

# The fraction of the last link's length, from its end, whose cross-section gives the radius; bounds, m.
_END_FRACTION = 0.25
_RADIUS_RANGE = (0.003, 0.016)
# Without any geometry: the tip's distance, relative to the length of the link before, and its radius, m.
_DEFAULT_LENGTH, _DEFAULT_RADIUS = 0.8, 0.008


@dataclass(frozen=True)
class Fingertip:
    """The centre of the rounded end of a finger.

    Attributes:
        body: the link that carries it.
        point: (3,) in the link's frame, m.
        radius: of the sphere around it that makes contact, m.
        source: the geometry it was taken from, for the user.
    """

    body: RigidBody
    point: np.ndarray
    radius: float
    source: str


def find_fingertip(structure: HandStructure, chain: Chain) -> Fingertip:
    """The end of a finger's collision geometry, else of its visual geometry, else a guess."""
    plant, inspector = structure.plant, structure.scene_graph.model_inspector()
    context = plant.CreateDefaultContext()
    X_RJ = [
        plant.GetJointByName(name, structure.hand).frame_on_child().CalcPoseInWorld(context)
        for name in chain.moving
    ]
    p_RJ = X_RJ[-1].translation()
    for role, source in ((Role.kProximity, "collision geometry"), (Role.kIllustration, "visual geometry")):
        parts = []
        for body in chain.bodies:
            X_RL = plant.EvalBodyPoseInWorld(context, body)
            parts += [(body, *part) for part in link_geometry(plant, inspector, body, role, X_RL)]
        if parts:
            return _end_of(parts, p_RJ, source)
    offsets = [p_RJ - X.translation() for X in X_RJ[::-1]]
    along = next((v for v in offsets if np.linalg.norm(v) > 1e-3), np.array([0.0, 0.0, 0.02]))
    X_RL = plant.EvalBodyPoseInWorld(context, chain.bodies[0])
    point = X_RL.inverse() @ (p_RJ + _DEFAULT_LENGTH * along)
    return Fingertip(chain.bodies[0], point, _DEFAULT_RADIUS, "the places of joints alone")


def _end_of(parts: list, p_RJ: np.ndarray, source: str) -> Fingertip:
    """The tip of geometries (link, pose of the link, pose of the shape, shape, points), all in R."""
    points = np.concatenate([points for *_, points in parts])
    distance = np.linalg.norm(points - p_RJ, axis=1)
    along = (points[distance.argmax()] - p_RJ) / distance.max()
    owner = np.repeat(np.arange(len(parts)), [len(points) for *_, points in parts])
    body, X_RL, X_RG, shape, _ = parts[owner[distance.argmax()]]
    if isinstance(shape, Sphere | Capsule):
        end = np.array([0.0, 0.0, 0.5 * shape.length() if isinstance(shape, Capsule) else 0.0])
        centre = max((X_RG @ end, X_RG @ -end), key=lambda p: float((p - p_RJ) @ along))
        return Fingertip(body, X_RL.inverse() @ centre, float(shape.radius()), f"a sphere of the {source}")
    depth = (points - p_RJ) @ along
    near = points[depth > (1 - _END_FRACTION) * depth.max()] - p_RJ
    across = near - np.outer(near @ along, along)
    _, _, axes = np.linalg.svd(across - across.mean(axis=0), full_matrices=False)
    low, high = (across @ axes[:2].T).min(axis=0), (across @ axes[:2].T).max(axis=0)
    radius = float(np.clip(0.5 * (high - low).min(), *_RADIUS_RANGE))
    radius = min(radius, 0.5 * depth.max())
    centre = p_RJ + along * (depth.max() - radius) + axes[:2].T @ (0.5 * (low + high))
    return Fingertip(body, X_RL.inverse() @ centre, radius, f"the end of the {source}")


def surface_points(inspector: SceneGraphInspector, geometry: GeometryId) -> np.ndarray | None:
    """(N, 3) points of a geometry in its frame, m: a hull's vertices, or the corners of the box around it.

    None for a mesh that Drake draws without reading it, and for shapes without bounds.
    """
    shape = inspector.GetShape(geometry)
    try:
        if isinstance(shape, Mesh | Convex):
            hull = shape.GetConvexHull()
            return np.array([hull.vertex(i) for i in range(hull.num_vertices())])
        box = CalcObb(shape)
    except RuntimeError:
        return None
    if box is None:
        return None
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1)
    return (box.pose() @ (box.half_width()[:, None] * signs)).T


def link_geometry(
    plant: MultibodyPlant, inspector: SceneGraphInspector, link: RigidBody, role: Role, X_BL: RigidTransform
) -> list[tuple[RigidTransform, RigidTransform, Shape, np.ndarray]]:
    """X_BL, X_BG, the shape and its surface points in B of each of a link's geometries of a role."""
    parts = []
    for geometry in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(link.index()), role):
        p_GP = surface_points(inspector, geometry)
        if p_GP is not None:
            X_BG = X_BL @ inspector.GetPoseInFrame(geometry)
            parts.append((X_BL, X_BG, inspector.GetShape(geometry), (X_BG @ p_GP.T).T))
    return parts


def palm_points(structure: HandStructure, X_RB: RigidTransform) -> np.ndarray:
    """(N, 3) points of the palm's geometry in the hand base B, m; without geometry its links' origins."""
    plant, inspector = structure.plant, structure.scene_graph.model_inspector()
    context = plant.CreateDefaultContext()
    X_BL = {body: X_RB.inverse() @ plant.EvalBodyPoseInWorld(context, body) for body in structure.palm}
    for role in (Role.kProximity, Role.kIllustration):
        found = [
            points
            for body, X in X_BL.items()
            for *_, points in link_geometry(plant, inspector, body, role, X)
        ]
        if found:
            return np.concatenate(found)
    return np.array([X.translation() for X in X_BL.values()])
