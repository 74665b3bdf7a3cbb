"""Converts meshes of a scene graph to Rerun archetypes in the body's frame B."""

import contextlib
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from pydrake.geometry import (
    ConvertVolumeToSurfaceMesh,
    Convex,
    GeometryId,
    Mesh,
    MeshSource,
    Role,
    SceneGraphInspector,
    TriangleSurfaceMesh,
    VolumeMesh,
)
from pydrake.math import RigidTransform

from geort_drake.systems.drawing import GLTF_UP, hull, load_mesh

# Name of an entity below that of the geometry, empty for the geometry's own, and an archetype.
Part = tuple[str, rr.AsComponents]


def draw_mesh(
    inspector: SceneGraphInspector, geometry: GeometryId, role: Role, color: list[int]
) -> list[Part] | None:
    """Returns the archetypes that draw a mesh or a convex shape; None for any other shape.

    Visual geometry is drawn from its file, with the file's materials. Collision geometry is drawn as Drake's
    contact model uses it: as the hydroelastic mesh, or else as the convex hull.

    Args:
        color: red, green, blue and opacity, 0–255, of parts without a material.
    """
    shape = inspector.GetShape(geometry)
    if not isinstance(shape, Mesh | Convex):
        return None
    X_BG = inspector.GetPoseInFrame(geometry)
    if isinstance(shape, Mesh) and role != Role.kProximity and shape.extension() in (".obj", ".gltf", ".glb"):
        try:
            with _on_disk(shape.source()) as path:
                return (_obj if shape.extension() == ".obj" else _gltf)(path, shape, X_BG, color)
        except Exception as error:  # trimesh raises many kinds of errors
            name = inspector.GetName(geometry)
            warnings.warn(f"geometry {name}: drawn as its convex hull; {error}", stacklevel=5)
    triangles = _hydroelastic(inspector, geometry) if role == Role.kProximity else None
    if triangles is None:
        triangles = hull(inspector, geometry)
    return None if triangles is None else [("", _flat(triangles, X_BG, albedo_factor=color))]


def _obj(path: Path, shape: Mesh, X_BG: RigidTransform, color: list[int]) -> list[Part]:
    """Returns one mesh per material of an OBJ file."""
    parts = list(load_mesh(path).geometry.values())
    meshes: list[Part] = []
    for number, part in enumerate(parts):
        triangles = part.triangles * shape.scale3()
        material = getattr(part.visual, "material", None)
        if material is None:
            look: dict[str, Any] = {"albedo_factor": color}
        elif material.image is not None and part.visual.uv is not None:
            # Texture coordinates start at the bottom in the file and at the top in Rerun.
            uv = part.visual.uv[part.faces].reshape(-1, 2) * [1, -1] + [0, 1]
            look = {"albedo_texture": np.asarray(material.image.convert("RGB")), "vertex_texcoords": uv}
        else:
            opacity = float(material.kwargs.get("d", [1.0])[-1])
            look = {"albedo_factor": [*map(int, material.main_color[:3]), round(255 * opacity)]}
        meshes.append((str(number) if len(parts) > 1 else "", _flat(triangles, X_BG, **look)))
    return meshes


def _gltf(path: Path, shape: Mesh, X_BG: RigidTransform, color: list[int]) -> list[Part]:
    """Returns a glTF file with embedded buffers and images, and its pose."""
    scene = load_mesh(path)
    has_materials = any(part.visual.defined for part in scene.geometry.values())
    axes = shape.scale3()[:, None] * GLTF_UP
    asset = rr.Asset3D(
        contents=scene.export(file_type="glb"),
        media_type="model/gltf-binary",
        albedo_factor=None if has_materials else color,
    )
    pose = rr.Transform3D(translation=X_BG.translation(), mat3x3=X_BG.rotation().matrix() @ axes)
    return [("", asset), ("", pose)]


@contextlib.contextmanager
def _on_disk(source: MeshSource) -> Iterator[Path]:
    """Provides the path of a mesh file; a mesh in memory is written to a temporary folder."""
    if source.is_path():
        yield source.path()
        return
    mesh = source.in_memory()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"mesh{mesh.mesh_file.extension()}"
        path.write_bytes(mesh.mesh_file.contents())
        for name, file in mesh.supporting_files.items():
            supporting = Path(folder) / name
            supporting.parent.mkdir(parents=True, exist_ok=True)
            supporting.write_bytes(file.read_bytes() if isinstance(file, Path) else file.contents())
        yield path


def _flat(triangles: np.ndarray, X_BG: RigidTransform, **look: Any) -> rr.Mesh3D:
    """Makes a mesh with flat shading from triangles (n, 3, 3) in frame G, m."""
    corners = triangles @ X_BG.rotation().matrix().T + X_BG.translation()
    # Triangles share no corners, so that each has its own normal and edges stay sharp.
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return rr.Mesh3D(
        vertex_positions=corners.reshape(-1, 3), vertex_normals=np.repeat(normals, 3, axis=0), **look
    )


def _hydroelastic(inspector: SceneGraphInspector, geometry: GeometryId) -> np.ndarray | None:
    """Returns the triangles (n, 3, 3), m, of the hydroelastic surface; None if there is none."""
    mesh = inspector.maybe_get_hydroelastic_mesh(geometry)
    if isinstance(mesh, VolumeMesh):
        mesh = ConvertVolumeToSurfaceMesh(mesh)
    if not isinstance(mesh, TriangleSurfaceMesh):
        return None
    vertices = np.array(mesh.vertices())
    return vertices[[[triangle.vertex(i) for i in range(3)] for triangle in mesh.triangles()],]
