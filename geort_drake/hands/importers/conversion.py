"""Copies models; convex hulls replace unreadable meshes and missing collision geometry."""

import copy
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import HandError, OutputError
from geort_drake.files import atomic_directory, require_fetched, write_text
from geort_drake.hands.assembly import parse_model
from geort_drake.hands.model_files import mesh_elements, read_model, set_mesh

_READABLE = (".obj", ".vtk", ".gltf")
_CONVERTIBLE = (".stl", ".glb", ".ply", ".dae")
# glTF has y up.
_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])


def unreadable_meshes(model: Path) -> list[Path]:
    """Returns the meshes of a model that Drake cannot read, in the order of the file.

    Raises:
        HandError: the model is missing or not XML.
    """
    meshes = dict.fromkeys(mesh for _, mesh in mesh_elements(model, read_model(model)))
    return [mesh for mesh in meshes if mesh.suffix.lower() not in _READABLE]


def convert_model(model: Path, folder: Path) -> Path:
    """Writes a copy of a model that Drake can read into a new folder; returns the copy's path.

    MJCF becomes a single file with its includes and explicit defaults. The hulls are next to the copy, whose
    mesh paths are all relative.

    Raises:
        HandError: a mesh is missing, damaged, or of an unknown format.
        OutputError: the folder contains other files than an earlier copy, or the model itself.
    """
    others = [path for path in folder.glob("*") if not re.fullmatch(r"\d+_\w+\.obj", path.name)]
    if model.resolve().parent == folder.resolve() or any(path.name != model.name for path in others):
        raise OutputError(f"{folder} exists and is no earlier copy of {model.name}; choose another --output")
    tree = read_model(model)
    with atomic_directory(folder) as draft:
        hulls: dict[Path, Path] = {}
        for mesh in unreadable_meshes(model):
            stem = re.sub(r"\W+", "_", mesh.stem)
            hulls[mesh] = folder.resolve() / f"{len(hulls)}_{stem}.obj"
            write_text(draft / hulls[mesh].name, _hull_of_mesh(mesh))
        write_text(draft / model.name, _text_of(tree, model, folder, hulls))
    return folder / model.name


def _text_of(tree: ET.Element, model: Path, folder: Path, hulls: Mapping[Path, Path]) -> str:
    """Returns a model's XML for a file in `folder`, with `hulls` and other meshes named relative to it."""
    for element, mesh in mesh_elements(model, tree):
        set_mesh(element, Path(os.path.relpath(hulls.get(mesh, mesh), folder.resolve())))
    for compiler in tree.iter("compiler"):  # of MJCF
        compiler.attrib.pop("meshdir", None)
        compiler.attrib.pop("assetdir", None)
    return ET.tostring(tree, encoding="unicode")


def add_collisions(model: Path) -> list[str]:
    """Gives links without collision geometry their visual geometry, or the convex hull of a visual mesh.

    Args:
        model: a URDF, SDF or MJCF file that Drake can read; it is overwritten.

    Returns:
        Names of the links that got collision geometry.

    Raises:
        HandError: the model cannot be loaded.
    """
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=0.001)
    hand = parse_model(plant, model, f"model {model}")
    tree, changed = read_model(model), []
    links = {link.get("name"): link for tag in ("body", "link") for link in tree.iter(tag)}
    for body in map(plant.get_body, plant.GetBodyIndices(hand)):
        link = links.get(body.name())
        if link is None or any(map(plant.GetCollisionGeometriesForBody, plant.GetBodiesWeldedTo(body))):
            continue
        shapes = [*link.findall("visual"), *link.findall("geom")]
        for number, shape in enumerate(shapes):
            name = f"{body.name()}_hull_{number}"
            if shape.tag == "geom":
                added = copy.deepcopy(shape)
                added.attrib |= {"name": name, "contype": "1", "conaffinity": "1", "group": "3"}
            else:
                added = ET.Element("collision", name=name)
                added.extend(part for part in shape if part.tag in ("origin", "pose", "geometry"))
            link.append(added)
        changed += [body.name()] if shapes else []
    write_text(model, _text_of(tree, model, model.parent, {}))
    return changed


def _hull_of_mesh(mesh: Path) -> str:
    """Returns the convex hull of a mesh as OBJ text, in the mesh's unit; for COLLADA in m."""
    if not mesh.is_file():
        raise HandError(f"the mesh file {mesh} is missing")
    require_fetched(mesh, HandError)
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
    hull.vertices = unit * hull.vertices @ (_Z_UP.T if suffix == ".glb" else np.eye(3))
    return trimesh.exchange.obj.export_obj(
        hull, include_normals=False, include_color=False, include_texture=False, digits=9, header=None
    )
