"""Copies URDF and SDF models with convex hulls in place of meshes that Drake cannot read."""

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from geort_drake.errors import HandError, OutputError
from geort_drake.files import atomic_directory, write_text
from geort_drake.hands.model_files import mesh_elements, read_model

if TYPE_CHECKING:
    import trimesh

_READABLE = (".obj", ".vtk", ".gltf")
_CONVERTIBLE = (".stl", ".glb", ".ply", ".dae")


def unreadable_meshes(model: Path) -> list[Path]:
    """Returns the meshes of a URDF or SDF model that Drake cannot read, in the order of the file.

    Raises:
        HandError: the model is missing or not XML.
    """
    tree = read_model(model)
    if tree.tag == "mujoco":
        return []  # MuJoCo reads them
    meshes = dict.fromkeys(mesh for _, mesh in mesh_elements(model, tree))
    return [mesh for mesh in meshes if mesh.suffix.lower() not in _READABLE]


def convert_model(model: Path, folder: Path) -> Path:
    """Writes a copy of a model that Drake can read into a new folder; returns the copy's path.

    The hulls are next to the copy, whose mesh paths are all relative.

    Raises:
        HandError: a mesh is missing, damaged, or of an unknown format.
        OutputError: the folder contains other files than an earlier copy, or the model itself.
    """
    from trimesh.exchange.obj import export_obj

    others = [path for path in folder.glob("*") if not re.fullmatch(r"\d+_\w+\.obj", path.name)]
    if model.resolve().parent == folder.resolve() or any(path.name != model.name for path in others):
        raise OutputError(f"{folder} exists and is no earlier copy of {model.name}; choose another --output")
    tree = read_model(model)
    with atomic_directory(folder) as draft:
        hulls: dict[Path, Path] = {}
        for mesh in unreadable_meshes(model):
            stem = re.sub(r"\W+", "_", mesh.stem)
            hulls[mesh] = folder.resolve() / f"{len(hulls)}_{stem}.obj"
            hull = _hull_of_mesh(mesh)
            text = export_obj(
                hull, include_normals=True, include_color=False, include_texture=False, digits=9, header=None
            )
            write_text(draft / hulls[mesh].name, text)
        write_text(draft / model.name, _text_of(tree, model, folder, hulls))
    return folder / model.name


def _text_of(tree: ET.Element, model: Path, folder: Path, hulls: Mapping[Path, Path]) -> str:
    """Returns a model's XML for a file in `folder`, with `hulls` and other meshes named relative to it."""
    for element, mesh in mesh_elements(model, tree):
        name = os.path.relpath(hulls.get(mesh, mesh), folder.resolve())
        if element.tag == "uri":
            element.text = name
        else:
            element.set("filename", name)
    colours: dict[str, dict[str, str]] = {}
    for number, material in enumerate(tree.iterfind(".//visual/material")):  # of URDF
        name, colour = material.get("name", ""), material.find("color")
        if colour is not None and colours.setdefault(name, colour.attrib) != colour.attrib:
            material.set("name", f"{name}_{number}")  # Drake refuses two materials of one name
    return ET.tostring(tree, encoding="unicode")


def _hull_of_mesh(mesh: Path) -> "trimesh.Trimesh":
    """Returns the convex hull of a mesh, in the mesh's axes and unit; for COLLADA in m.

    In the .glb meshes of published hands, z is up as in URDF, and not y as in glTF, so axes are kept.
    """
    if not mesh.is_file():
        raise HandError(f"the mesh file {mesh} is missing")
    suffix = mesh.suffix.lower()
    if suffix not in _CONVERTIBLE:
        raise HandError(
            f"{mesh}: unknown mesh format; Drake reads {', '.join(_READABLE)}, and {', '.join(_CONVERTIBLE)} "
            "are converted"
        )
    import trimesh

    try:
        scene = trimesh.load_scene(mesh, file_type=suffix[1:])
        hull = trimesh.convex.convex_hull(scene.to_mesh().vertices)
        # As in ROS, the unit of a COLLADA file is applied, and its up axis is ignored.
        unit = trimesh.units.unit_conversion(scene.units or "meters", "meters") if suffix == ".dae" else 1.0
    except Exception as error:  # each format raises its own exceptions
        raise HandError(f"{mesh}: not a readable {suffix} mesh: {error}") from error
    hull.vertices = unit * hull.vertices
    return hull
