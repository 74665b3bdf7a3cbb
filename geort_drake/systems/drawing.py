"""The drawn geometry of a plant, for any viewer: which shapes, their size, colour and triangles."""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    GeometryId,
    HalfSpace,
    Role,
    SceneGraphInspector,
    Shape,
    Sphere,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

# Drake rotates a glTF file's y axis to its own z axis before scaling.
GLTF_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_HALF_SPACE_SIDE = 2.0  # m; a half space is drawn as a square
_SOLIDS: dict[type, Callable[[Any], tuple[str, list[float]]]] = {
    Box: lambda s: ("box", s.size().tolist()),
    HalfSpace: lambda s: ("box", [_HALF_SPACE_SIDE, _HALF_SPACE_SIDE, 0.0]),
    Sphere: lambda s: ("ellipsoid", 3 * [s.radius()]),
    Ellipsoid: lambda s: ("ellipsoid", [s.a(), s.b(), s.c()]),
    Cylinder: lambda s: ("cylinder", [s.radius(), s.length()]),
    Capsule: lambda s: ("capsule", [s.radius(), s.length()]),
}


def drawn_geometries(
    plant: MultibodyPlant, inspector: SceneGraphInspector, body: RigidBody, role: Role = Role.kIllustration
) -> tuple[list[GeometryId], Role]:
    """Returns a body's geometry of the role, or without any its proximity geometry, and the role of these."""
    frame = plant.GetBodyFrameIdIfExists(body.index())
    if frame is None:
        return [], role
    if geometries := inspector.GetGeometries(frame, role):
        return geometries, role
    return inspector.GetGeometries(frame, Role.kProximity), Role.kProximity


def solid_of(shape: Shape) -> tuple[str, list[float]] | None:
    """Returns kind and size, m, of a shape that is not a mesh; None for any other.

    Kinds are "box" with three edges, "ellipsoid" with three half axes, and "cylinder" and "capsule" with
    radius and length.
    """
    return _SOLIDS[type(shape)](shape) if type(shape) in _SOLIDS else None


def diffuse_color(inspector: SceneGraphInspector, geometry: GeometryId) -> list[float]:
    """Returns red, green, blue and opacity, 0–1, of a geometry by its properties of any role; else grey."""
    for properties in (
        inspector.GetIllustrationProperties(geometry),
        inspector.GetPerceptionProperties(geometry),
        inspector.GetProximityProperties(geometry),
    ):
        if properties is not None and properties.HasProperty("phong", "diffuse"):
            return properties.GetProperty("phong", "diffuse").rgba.tolist()
    return [0.75, 0.75, 0.78, 1.0]


def load_triangles(path: Path, scale: np.ndarray) -> np.ndarray:
    """Returns the triangles (n, 3, 3), m, of a mesh file at a scale (3,), in the axes that Drake uses."""
    triangles = np.asarray(load_mesh(path).to_mesh().triangles)
    rotated = triangles if path.suffix == ".obj" else triangles @ GLTF_UP.T
    return rotated * scale


def load_mesh(path: Path) -> Any:
    """Loads a file and the files that it references, by percent-encoded names, as a trimesh scene."""
    import trimesh  # imported here, because few plants have meshes

    class Resolver(trimesh.resolvers.FilePathResolver):
        def get(self, name: str) -> bytes:
            return (path.parent / unquote(name.strip())).read_bytes()

    return trimesh.load_scene(path, process=False, resolver=Resolver(str(path)))


def hull(inspector: SceneGraphInspector, geometry: GeometryId) -> np.ndarray | None:
    """Returns the triangles (n, 3, 3), m, of the convex hull; None if Drake cannot compute it."""
    try:
        surface = inspector.GetConvexHull(geometry)
    except RuntimeError:  # Drake computes hulls on demand; the file may be unreadable
        return None
    vertices = np.array([surface.vertex(i) for i in range(surface.num_vertices())])
    fans = []
    for face in map(surface.element, range(surface.num_elements())):
        ring = [face.vertex(i) for i in range(face.num_vertices())]
        fans += [[ring[0], a, b] for a, b in itertools.pairwise(ring[1:])]
    return vertices[fans]
