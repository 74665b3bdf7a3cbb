"""The drawn geometry of a plant, for any viewer: which shapes, their colour, and the triangles of meshes."""

import itertools
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from pydrake.geometry import GeometryId, Rgba, Role, SceneGraphInspector
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

# Drake rotates a glTF file's y axis to its own z axis before scaling.
GLTF_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
HALF_SPACE_SIDE = 2.0  # m; a half space is drawn as a square
_DEFAULT_COLOR = Rgba(0.75, 0.75, 0.78, 1.0)


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


def diffuse_color(inspector: SceneGraphInspector, geometry: GeometryId) -> Rgba:
    """Returns the colour of a geometry by its properties of any role; grey without one."""
    for properties in (
        inspector.GetIllustrationProperties(geometry),
        inspector.GetPerceptionProperties(geometry),
        inspector.GetProximityProperties(geometry),
    ):
        if properties is not None and properties.HasProperty("phong", "diffuse"):
            return properties.GetProperty("phong", "diffuse")
    return _DEFAULT_COLOR


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
