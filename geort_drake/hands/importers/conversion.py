"""Copies URDF and SDF models with convex hulls in place of meshes that Drake cannot read."""

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from geort_drake.errors import HandError, OutputError
from geort_drake.files import atomic_directory, write_text
from geort_drake.hands.model_files import mesh_elements, read_model, resolve_reference

if TYPE_CHECKING:
    import trimesh

_READABLE = (".obj", ".vtk", ".gltf")
_CONVERTIBLE = (".stl", ".glb", ".ply", ".dae")
# Rotates coordinates with y up, as in glTF, to z up.
_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])


def unreadable_meshes(model: Path) -> list[Path]:
    """Returns the meshes of a URDF or SDF model that Drake cannot read, in the order of the file.

    Raises:
        HandError: the model is missing or not XML.
    """
    if read_model(model).tag == "mujoco":
        return []  # MuJoCo reads them
    meshes = dict.fromkeys(mesh for _, mesh in mesh_elements(model, read_model(model)))
    return [mesh for mesh in meshes if mesh.suffix.lower() not in _READABLE]


def convert_model(model: Path, folder: Path, notes: list[str]) -> Path:
    """Writes a copy of a model that Drake can read into a new folder; returns the copy's path.

    The hulls are next to the copy, whose mesh paths are all relative. Meshes in .glb have y up, unless the
    centers of mass of a URDF indicate z up: `notes` then receives a sentence.

    Raises:
        HandError: a mesh is missing, damaged, or of an unknown format; or a pose or scale is invalid.
        OutputError: the folder contains other files than an earlier copy, or the model itself.
    """
    from trimesh.exchange.obj import export_obj

    others = [path for path in folder.glob("*") if not re.fullmatch(r"\d+_\w+\.obj", path.name)]
    if model.resolve().parent == folder.resolve() or any(path.name != model.name for path in others):
        raise OutputError(f"{folder} exists and is no earlier copy of {model.name}; choose another --output")
    tree = read_model(model)
    with atomic_directory(folder) as draft:
        hulls = {mesh: _hull_of_mesh(mesh) for mesh in unreadable_meshes(model)}
        glb = {mesh: hull for mesh, hull in hulls.items() if mesh.suffix.lower() == ".glb"}
        if _has_y_up(tree, model, glb):
            for hull in glb.values():
                hull.vertices = hull.vertices @ _Z_UP.T
        else:
            notes.append("the .glb meshes have z up, not y, as the links' centers of mass indicate")
        names: dict[Path, Path] = {}
        for mesh, hull in hulls.items():
            stem = re.sub(r"\W+", "_", mesh.stem)
            names[mesh] = folder.resolve() / f"{len(names)}_{stem}.obj"
            text = export_obj(
                hull, include_normals=True, include_color=False, include_texture=False, digits=9, header=None
            )
            write_text(draft / names[mesh].name, text)
        write_text(draft / model.name, _text_of(tree, model, folder, names))
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


def _has_y_up(tree: ET.Element, model: Path, hulls: "Mapping[Path, trimesh.Trimesh]") -> bool:
    """Decides whether .glb meshes have y up, as in glTF, or z up, as in the .glb meshes of many URDF files.

    In the right axes, the hulls' centers are nearer to the links' centers of mass. Without these, y is up.

    Args:
        tree: XML of the model.
        model: file of the model.
        hulls: hulls of the meshes, in the meshes' own axes.
    """
    distances = np.zeros(2)  # sums over the links' shapes with y and with z up, m
    for link in tree.iter("link"):
        inertial = link.find("inertial/origin")
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh, origin = shape.find("geometry/mesh"), shape.find("origin")
            hull = None if mesh is None else hulls.get(resolve_reference(model, mesh.get("filename", "")))
            if hull is None or inertial is None:
                continue
            X_LM = RigidTransform(RollPitchYaw(_numbers(origin, "rpy")), _numbers(origin, "xyz"))
            centers = np.column_stack([_Z_UP @ hull.center_mass, hull.center_mass])
            p_LC = X_LM @ (_numbers(mesh, "scale", "1 1 1")[:, None] * centers)
            distances += np.linalg.norm(p_LC - _numbers(inertial, "xyz")[:, None], axis=0)
    return bool(distances[0] <= distances[1])


def _numbers(element: ET.Element | None, attribute: str, default: str = "0 0 0") -> np.ndarray:
    """Returns the three numbers of an attribute, or the default ones."""
    text = default if element is None else element.get(attribute, default)
    try:
        return np.array(text.split(), float).reshape(3)
    except ValueError as error:
        raise HandError(f"{attribute} must be three numbers; given: {text}") from error


def _hull_of_mesh(mesh: Path) -> "trimesh.Trimesh":
    """Returns the convex hull of a mesh, in the mesh's axes and unit; for COLLADA in m."""
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
