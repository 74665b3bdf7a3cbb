"""The shapes of a model's links, as points on their surfaces."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from pydrake.geometry import (
    CalcObb,
    Convex,
    GeometryId,
    Mesh,
    Role,
    SceneGraph,
    SceneGraphInspector,
    Shape,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, RigidBody


class Part(NamedTuple):
    """A geometry G: its link L, its pose in a frame F, its shape, and points (N, 3) in F, m."""

    link: RigidBody
    X_FG: RigidTransform
    shape: Shape
    points: np.ndarray


def parts_of(
    plant: MultibodyPlant, scene_graph: SceneGraph, links: Iterable[RigidBody], role: Role, frame: Frame
) -> list[Part]:
    """Returns the links' geometries that have a role, expressed in a frame, in the default posture."""
    inspector, context = scene_graph.model_inspector(), plant.CreateDefaultContext()
    parts = []
    for link in links:
        X_FL = plant.CalcRelativeTransform(context, frame, link.body_frame())
        for geometry in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(link.index()), role):
            p_GP = surface_points(inspector, geometry)
            if p_GP is not None:
                X_FG = X_FL @ inspector.GetPoseInFrame(geometry)
                parts.append(Part(link, X_FG, inspector.GetShape(geometry), (X_FG @ p_GP.T).T))
    return parts


def surface_points(inspector: SceneGraphInspector, geometry: GeometryId) -> np.ndarray | None:
    """Returns points (N, 3) of a geometry in its frame, m: vertices of its hull, or corners of its box.

    Returns None for a mesh that Drake draws without reading it, and for unbounded shapes.
    """
    shape = inspector.GetShape(geometry)
    try:
        if isinstance(shape, Mesh | Convex):
            return hull_vertices(shape)
        box = CalcObb(shape)
    except RuntimeError:
        return None
    if box is None:
        return None
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1)
    return (box.pose() @ (box.half_width()[:, None] * signs)).T


def hull_vertices(shape: Convex | Mesh) -> np.ndarray:
    """Returns the vertices (N, 3) of a mesh's convex hull, m; raises RuntimeError without a readable mesh."""
    hull = shape.GetConvexHull()
    return np.array([hull.vertex(i) for i in range(hull.num_vertices())])
