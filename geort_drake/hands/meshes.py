"""Copies of models whose meshes Drake cannot read, with these meshes' convex hulls as .obj files.

Only convex hulls count in collisions anyway, and the tips of fingers are read off them.
"""

import json
import re
import struct
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from geort_drake.errors import HandError
from geort_drake.files import atomic_directory, write_text
from geort_drake.hands.couplings import model_tree

_READABLE = (".obj", ".vtk", ".gltf")
_CONVERTIBLE = (".stl", ".glb")
# A glTF file has y up; z is up where it is used.
_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])


def unreadable_meshes(model: Path) -> list[Path]:
    """The meshes of a model that Drake does not read, in the order of the file.

    Raises:
        HandError: the model is no XML.
    """
    tree = model_tree(model)
    meshes = [_mesh_file(model, tree, name) for name in _named(tree)]
    return [mesh for mesh in dict.fromkeys(meshes) if mesh.suffix.lower() not in _READABLE]


def convert_meshes(model: Path, folder: Path) -> Path:
    """Writes a copy of a model, whole, into a folder of its own, and returns the copy.

    In an MJCF model the included files become part of it.

    Raises:
        HandError: a mesh is missing, damaged, or of a kind that is not converted.
    """
    tree = model_tree(model)
    with atomic_directory(folder) as draft:
        written: dict[Path, str] = {}
        if tree.tag == "mujoco":
            # Drake wants a name, MuJoCo does not.
            tree.set("model", tree.get("model") or model.stem)
        for element, name in _elements(tree):
            mesh = _mesh_file(model, tree, name)
            if mesh.suffix.lower() in _READABLE:
                target = str(mesh)
            else:
                if mesh not in written:
                    stem = re.sub(r"\W+", "_", mesh.stem)
                    written[mesh] = f"{len(written)}_{stem}.obj"
                    write_text(draft / written[mesh], _hull_obj(mesh))
                target = str((folder / written[mesh]).resolve())
            _rename(tree, element, name, target)
        write_text(draft / model.name, ET.tostring(tree, encoding="unicode"))
    return folder / model.name


def _named(tree: ET.Element) -> list[str]:
    return [name for _, name in _elements(tree)]


def _elements(tree: ET.Element) -> list[tuple[ET.Element, str]]:
    """The elements that name a mesh file, and the name: MJCF in assets, URDF by attribute, SDF by text."""
    if tree.tag == "mujoco":
        return [(mesh, mesh.get("file", "")) for mesh in tree.iterfind(".//asset/mesh") if mesh.get("file")]
    urdf = [(mesh, mesh.get("filename", "")) for mesh in tree.iter("mesh") if mesh.get("filename")]
    sdf = [(uri, (uri.text or "").strip()) for uri in tree.iterfind(".//mesh/uri")]
    return urdf + sdf


def _rename(tree: ET.Element, element: ET.Element, name: str, target: str) -> None:
    if tree.tag == "mujoco":
        # Without a name, a mesh is called as its file.
        element.set("name", element.get("name") or Path(name).stem)
        element.set("file", target)
    elif element.tag == "uri":
        element.text = f"file://{target}"
    else:
        element.set("filename", f"file://{target}")


def _mesh_file(model: Path, tree: ET.Element, name: str) -> Path:
    if tree.tag != "mujoco":
        return resolved(model, name)
    folder = model.resolve().parent
    for compiler in tree.iter("compiler"):
        folder = folder / (compiler.get("meshdir") or compiler.get("assetdir") or "")
    return (folder / name).resolve()


def resolved(model: Path, name: str) -> Path:
    """The file that a model names: beside it, or of a package in the folders above it."""
    folder = model.resolve().parent
    package = re.match(r"(?:package|model)://([^/]+)(?:/(.*))?$", name)
    if package:
        for parent in (folder, *folder.parents):
            place = parent if parent.name == package[1] else parent / package[1]
            if place.is_dir():
                return (place / (package[2] or "")).resolve()
    return (folder / name.removeprefix("file://")).resolve()


def _hull_obj(mesh: Path) -> str:
    """The convex hull of a mesh as an OBJ file, in the mesh's unit."""
    if not mesh.is_file():
        raise HandError(f"the mesh file {mesh} is missing")
    suffix = mesh.suffix.lower()
    if suffix not in _CONVERTIBLE:
        raise HandError(
            f"{mesh}: Drake reads {', '.join(_READABLE)}, and {', '.join(_CONVERTIBLE)} are converted; "
            "convert this mesh to .obj"
        )
    # Few hands need it, and its import takes as long as Drake's.
    from scipy.spatial import ConvexHull, QhullError

    try:
        points = (_stl_points if suffix == ".stl" else _glb_points)(mesh.read_bytes())
        hull = ConvexHull(points)
    except (ValueError, KeyError, IndexError, TypeError, struct.error, QhullError) as error:
        raise HandError(f"{mesh}: not a readable {suffix} mesh with a volume: {error}") from error
    number = {int(vertex): row for row, vertex in enumerate(hull.vertices, start=1)}
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points[hull.vertices]]
    centre = points[hull.vertices].mean(axis=0)
    for face in hull.simplices:
        a, b, c = points[face]
        outwards = np.cross(b - a, c - a) @ (a - centre) > 0
        i, j, k = (number[int(vertex)] for vertex in (face if outwards else face[::-1]))
        lines.append(f"f {i} {j} {k}")
    return "\n".join(lines) + "\n"


def _stl_points(data: bytes) -> np.ndarray:
    """(N, 3) vertices of a binary or ASCII STL file."""
    if data[:5] == b"solid" and b"facet" in data[:2000]:
        rows = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", data)
        return np.array([[float(value) for value in row] for row in rows])
    (count,) = struct.unpack_from("<I", data, 80)
    triangle = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(data, triangle, count, 84)["vertices"].reshape(-1, 3).astype(float)


def _glb_points(data: bytes) -> np.ndarray:
    """(N, 3) vertices of all meshes of a binary glTF 2.0 file, z up."""
    (length,) = struct.unpack_from("<I", data, 12)
    scene = json.loads(data[20 : 20 + length])
    start = 28 + length
    points: list[np.ndarray] = []

    def visit(number: int, X: np.ndarray) -> None:
        node = scene["nodes"][number]
        X = X @ _node_transform(node)
        mesh = scene["meshes"][node["mesh"]] if "mesh" in node else {"primitives": []}
        for primitive in mesh["primitives"]:
            accessor = scene["accessors"][primitive["attributes"]["POSITION"]]
            view = scene["bufferViews"][accessor["bufferView"]]
            offset = start + view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
            stride = view.get("byteStride", 12)
            rows = np.ndarray((accessor["count"], 3), "<f4", data, offset, (stride, 4))
            points.append(rows @ X[:3, :3].T + X[:3, 3])
        for child in node.get("children", []):
            visit(child, X)

    for number in scene["scenes"][scene.get("scene", 0)]["nodes"]:
        visit(number, np.eye(4))
    return np.concatenate(points).astype(float) @ _Z_UP.T


def _node_transform(node: dict) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", [0.0, 0.0, 0.0, 1.0])
    X = np.eye(4)
    X[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    X[:3, :3] *= node.get("scale", [1.0, 1.0, 1.0])
    X[:3, 3] = node.get("translation", [0.0, 0.0, 0.0])
    return X
