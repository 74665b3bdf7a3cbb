"""Meshes of a scene graph as Rerun's archetypes, placed in the body's frame B."""

import base64
import itertools
import json
import mimetypes
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import rerun as rr
from pydrake.geometry import (
    AddRigidHydroelasticProperties,
    ConvertVolumeToSurfaceMesh,
    Convex,
    GeometryId,
    GeometryInstance,
    Mesh,
    MeshSource,
    ProximityProperties,
    ReadObjToTriangleSurfaceMesh,
    Role,
    SceneGraph,
    SceneGraphInspector,
    TriangleSurfaceMesh,
    VolumeMesh,
)
from pydrake.math import RigidTransform

from geort_drake.rerun.obj import read_painted

# Drake turns a glTF file's y axis up to its own z before it scales.
_GLTF_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def draw_mesh(
    inspector: SceneGraphInspector, geometry: GeometryId, role: Role, color: list[int]
) -> list[rr.AsComponents] | None:
    """The archetypes of one entity that draw a mesh or a convex shape; None for any other shape.

    What is to be seen is drawn as its file has it; what collides, as Drake's contact model has it: as the
    hydroelastic mesh, or else as the convex hull.
    """
    shape = inspector.GetShape(geometry)
    if not isinstance(shape, Mesh | Convex):
        return None
    X_BG = inspector.GetPoseInFrame(geometry)
    if isinstance(shape, Mesh) and role != Role.kProximity:
        if shape.extension() in (".gltf", ".glb"):
            try:
                return _gltf(shape, X_BG, color)
            except (OSError, ValueError) as error:
                name = inspector.GetName(geometry)
                warnings.warn(f"geometry {name}: drawn as its convex hull; {error}", stacklevel=5)
        elif shape.extension() == ".obj":
            try:
                return [_obj(shape, X_BG, color)]
            except (OSError, ValueError) as error:
                name = inspector.GetName(geometry)
                warnings.warn(f"geometry {name}: drawn in one colour; {error}", stacklevel=5)
                return [_flat(_plain_obj(shape), X_BG, color)]
        elif (surface := _volume_surface(shape)) is not None:
            return [_flat(surface, X_BG, color)]
    surface = _hydroelastic(inspector, geometry) if role == Role.kProximity else None
    if surface is None:
        surface = _hull(inspector, geometry)
    return None if surface is None else [_flat(surface, X_BG, color)]


def _flat(triangles: np.ndarray, X_BG: RigidTransform, color: list[int] | None, **paint: Any) -> rr.Mesh3D:
    """A mesh of triangles (n, 3, 3), m, in frame G; `paint` is what Rerun knows beside one colour."""
    corners = triangles @ X_BG.rotation().matrix().T + X_BG.translation()
    # Corners are not shared, so that every triangle has its own normal and edges stay sharp.
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return rr.Mesh3D(
        vertex_positions=corners.reshape(-1, 3),
        vertex_normals=np.repeat(normals, 3, axis=0),
        albedo_factor=color,
        **paint,
    )


def _triangles(surface: TriangleSurfaceMesh) -> np.ndarray:
    """Corners (n, 3, 3) of a surface's triangles, m."""
    corners = np.array(surface.vertices())
    return corners[[[triangle.vertex(i) for i in range(3)] for triangle in surface.triangles()],]


def _obj(shape: Mesh, X_BG: RigidTransform, color: list[int]) -> rr.Mesh3D:
    """An OBJ file with its own materials, which come before other colours as in Drake's renderers.

    Raises:
        ValueError, OSError: of the files that it names one is malformed or missing.
    """
    source = shape.source()
    contents = source.path().read_bytes() if source.is_path() else _bytes(source.in_memory().mesh_file)
    painted = read_painted(contents, _reader(source), color)
    if painted is None:
        return _flat(_plain_obj(shape), X_BG, color)
    triangles = painted.triangles * shape.scale3()
    if painted.picture is None or painted.places is None:
        return _flat(triangles, X_BG, None, vertex_colors=np.repeat(painted.colors, 3, axis=0))
    places = painted.places.reshape(-1, 2)
    shade = painted.colors[0].tolist()
    return _flat(triangles, X_BG, shade, vertex_texcoords=places, albedo_texture=painted.picture)


def _plain_obj(shape: Mesh) -> np.ndarray:
    source = shape.source()
    if source.is_path():
        return _triangles(ReadObjToTriangleSurfaceMesh(source.path(), scale3=shape.scale3()))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mesh.obj"
        file.write_bytes(_bytes(source.in_memory().mesh_file))
        return _triangles(ReadObjToTriangleSurfaceMesh(file, scale3=shape.scale3()))


def _volume_surface(shape: Mesh) -> np.ndarray | None:
    """Triangles of the surface of a volume, such as a .vtk file's; None where Drake makes none of it."""
    properties = ProximityProperties()
    AddRigidHydroelasticProperties(1.0, properties)
    instance = GeometryInstance(RigidTransform(), shape, "volume")
    instance.set_proximity_properties(properties)
    # Drake's reader of volumes can only be had through a scene graph.
    scene_graph: Any = SceneGraph()
    try:
        geometry = scene_graph.RegisterAnchoredGeometry(scene_graph.RegisterSource("mesh"), instance)
    except RuntimeError:
        return None
    return _hydroelastic(scene_graph.model_inspector(), geometry)


def _hydroelastic(inspector: SceneGraphInspector, geometry: GeometryId) -> np.ndarray | None:
    mesh = inspector.maybe_get_hydroelastic_mesh(geometry)
    if isinstance(mesh, VolumeMesh):
        mesh = ConvertVolumeToSurfaceMesh(mesh)
    return _triangles(mesh) if isinstance(mesh, TriangleSurfaceMesh) else None


def _hull(inspector: SceneGraphInspector, geometry: GeometryId) -> np.ndarray | None:
    try:
        hull = inspector.GetConvexHull(geometry)
    except RuntimeError:  # Drake makes it when it is asked for, and may find the file unreadable
        return None
    corners = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    fans = []
    for face in map(hull.element, range(hull.num_elements())):
        ring = [face.vertex(i) for i in range(face.num_vertices())]
        fans += [[ring[0], a, b] for a, b in itertools.pairwise(ring[1:])]
    return corners[fans]


def _gltf(shape: Mesh, X_BG: RigidTransform, color: list[int]) -> list[rr.AsComponents]:
    """A glTF file with its own materials, and where it stands.

    Raises:
        ValueError: the file needs an extension of glTF, which Rerun may not draw, or is malformed.
        OSError: a file that it names is missing.
    """
    source = shape.source()
    media_type = "model/gltf-binary" if shape.extension() == ".glb" else "model/gltf+json"
    contents = source.path().read_bytes() if source.is_path() else _bytes(source.in_memory().mesh_file)
    has_materials = True
    if shape.extension() == ".gltf":
        scene = json.loads(contents)
        if scene.get("extensionsRequired"):
            raise ValueError(f"it needs {', '.join(scene['extensionsRequired'])}")
        has_materials = bool(scene.get("materials"))
        _embed(scene, _reader(source))
        contents = json.dumps(scene).encode()
    scaled = shape.scale3()[:, None] * _GLTF_UP
    return [
        rr.Asset3D(contents=contents, media_type=media_type, albedo_factor=None if has_materials else color),
        rr.Transform3D(translation=X_BG.translation(), mat3x3=X_BG.rotation().matrix() @ scaled),
    ]


def _embed(scene: dict, read: Callable[[str], bytes]) -> None:
    """Takes the buffers and images that lie beside a glTF file into it: Rerun sees only the one file."""
    for part in (*scene.get("buffers", ()), *scene.get("images", ())):
        uri = part.get("uri", "data:")
        if not uri.startswith("data:"):
            kind = mimetypes.guess_type(uri)[0] or "application/octet-stream"
            part["uri"] = f"data:{kind};base64,{base64.b64encode(read(uri)).decode()}"


def _reader(source: MeshSource) -> Callable[[str], bytes]:
    """What reads the files that a mesh's file names."""
    if source.is_path():
        return lambda uri: (source.path().parent / unquote(uri)).read_bytes()
    beside = source.in_memory().supporting_files

    def read(uri: str) -> bytes:
        if uri not in beside:
            raise ValueError(f"'{uri}' is missing beside the mesh")
        return _bytes(beside[uri])

    return read


def _bytes(file: Any) -> bytes:
    """Contents of Drake's `MemoryFile`, or of a path."""
    return file.read_bytes() if isinstance(file, Path) else file.contents()
