"""Copies of models that Drake does not read as they are meant: of their meshes, or of MJCF's defaults.

Meshes become their convex hulls as .obj files. Only convex hulls count in collisions anyway, and the tips of
fingers are read off them.
"""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from geort_drake.errors import HandError
from geort_drake.files import atomic_directory, write_text
from geort_drake.hands.couplings import model_tree
from geort_drake.hands.mjcf import hand_down_defaults, some_of

_READABLE = (".obj", ".vtk", ".gltf")
_CONVERTIBLE = (".stl", ".glb", ".ply", ".dae")
_FLAT = 1e-6  # of the size; what is thinner has no volume
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


def what_drake_misreads(model: Path) -> list[str]:
    """Sentences on what Drake does not read of a model, or not as it is meant; `convert_model` mends it.

    Raises:
        HandError: the model is no XML.
    """
    said = []
    if meshes := unreadable_meshes(model):
        said.append(
            f"Drake does not read {len(meshes)} of the meshes, such as {meshes[0].name}, so convex hulls "
            "stand in for them"
        )
    tree = model_tree(model)
    if tree.tag == "mujoco" and (classes := hand_down_defaults(tree)):
        named = some_of([f"'{name}'" for name in classes])
        said.append(
            f"Drake does not hand defaults down to the classes {named}, which leaves joints without axes, "
            "limits or gains, or shapes without sizes"
        )
    return said


def convert_model(model: Path, folder: Path) -> Path:
    """Writes a copy of a model, whole, into a folder of its own, and returns the copy.

    In an MJCF model the included files become part of it, and defaults are written out.

    Raises:
        HandError: a mesh is missing, damaged, or of a kind that is not converted.
    """
    tree = model_tree(model)
    with atomic_directory(folder) as draft:
        written: dict[Path, str] = {}
        if tree.tag == "mujoco":
            # Drake wants a name, MuJoCo does not.
            tree.set("model", tree.get("model") or model.stem)
            hand_down_defaults(tree)
        for element, name in _elements(tree):
            mesh = _mesh_file(model, tree, name)
            if mesh.suffix.lower() in _READABLE:
                target = str(mesh)
            else:
                if mesh not in written:
                    stem = re.sub(r"\W+", "_", mesh.stem)
                    written[mesh] = f"{len(written)}_{stem}.obj"
                    write_text(draft / written[mesh], _converted(mesh))
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


def hull_obj(points: np.ndarray) -> str | None:
    """The convex hull of points (N, 3) as an OBJ file, in their unit; None if it has no finite volume."""
    import trimesh  # few hands need it

    if not len(points) or not np.isfinite(points).all():
        return None
    spread = points - points.mean(axis=0)
    if np.linalg.matrix_rank(spread, tol=_FLAT * np.linalg.norm(spread)) < 3:
        return None
    return trimesh.exchange.obj.export_obj(
        trimesh.convex.convex_hull(points),
        include_normals=False,
        include_color=False,
        include_texture=False,
        digits=9,
        header=None,
    )


def _converted(mesh: Path) -> str:
    """The convex hull of a mesh as an OBJ file, in the mesh's unit; COLLADA names its own."""
    if not mesh.is_file():
        raise HandError(f"the mesh file {mesh} is missing")
    suffix = mesh.suffix.lower()
    if suffix not in _CONVERTIBLE:
        raise HandError(
            f"{mesh}: Drake reads {', '.join(_READABLE)}, and {', '.join(_CONVERTIBLE)} are converted; "
            "convert this mesh to .obj"
        )
    import trimesh

    try:
        scene = trimesh.load_scene(mesh, file_type=suffix[1:])
        points = np.asarray(scene.to_mesh().vertices)
        # As ROS has it, a file's unit counts, and which axis it calls up does not.
        unit = trimesh.units.unit_conversion(scene.units or "meters", "meters") if suffix == ".dae" else 1.0
    except Exception as error:  # each format has its own kinds
        raise HandError(f"{mesh}: not a readable {suffix} mesh: {error}") from error
    text = hull_obj(unit * points @ (_Z_UP.T if suffix == ".glb" else np.eye(3)))
    if text is None:
        raise HandError(
            f"{mesh}: not a readable {suffix} mesh with a volume: it is empty, flat or not finite"
        )
    return text
