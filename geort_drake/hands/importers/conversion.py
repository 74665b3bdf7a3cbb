"""Converts models so that Drake reads them correctly: meshes become hulls, MJCF defaults are explicit."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
from pydrake.geometry import Role
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex, WeldJoint
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import HandError
from geort_drake.files import atomic_directory, require_fetched, write_text
from geort_drake.hands.assembly import parse_model
from geort_drake.hands.chains import inboard_joints
from geort_drake.hands.importers.fingertips import link_geometry
from geort_drake.hands.mjcf import inherit_defaults
from geort_drake.hands.model_files import mesh_elements, read_model

_READABLE = (".obj", ".vtk", ".gltf")
_CONVERTIBLE = (".stl", ".glb", ".ply", ".dae")
_FLATNESS = 1e-6  # relative thickness below which points have no volume
# glTF has y up.
_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])


def unreadable_meshes(model: Path) -> list[Path]:
    """The meshes of a model that Drake does not read, in the order of the file.

    Raises:
        HandError: the model is not XML.
    """
    meshes = dict.fromkeys(mesh for _, mesh in mesh_elements(model, read_model(model)))
    return [mesh for mesh in meshes if mesh.suffix.lower() not in _READABLE]


def drake_misreadings(model: Path) -> list[str]:
    """Notes on parts of a model that Drake ignores or misreads; `convert_model` corrects them.

    Raises:
        HandError: the model is not XML.
    """
    notes = []
    if meshes := unreadable_meshes(model):
        names = ", ".join(mesh.name for mesh in meshes)
        notes.append(f"convex hulls replace meshes that Drake does not read: {names}")
    tree = read_model(model)
    if tree.tag == "mujoco" and (classes := inherit_defaults(tree)):
        notes.append(
            f"Drake loses axes, limits, gains or sizes from the default classes {', '.join(classes)}"
        )
    return notes


def convert_model(model: Path, folder: Path) -> Path:
    """Writes a converted copy of a model into a folder of its own; returns the copy.

    MJCF becomes one file with all includes, and its default classes inherit as in MuJoCo.

    Raises:
        HandError: a mesh is missing, damaged, or of an unknown format.
    """
    tree = read_model(model)
    with atomic_directory(folder) as draft:
        hulls: dict[Path, str] = {}
        if tree.tag == "mujoco":
            tree.set("model", tree.get("model") or model.stem)  # Drake requires a name
            inherit_defaults(tree)
        for element, mesh in mesh_elements(model, tree):
            target = str(mesh)
            if mesh.suffix.lower() not in _READABLE:
                if mesh not in hulls:
                    stem = re.sub(r"\W+", "_", mesh.stem)
                    hulls[mesh] = f"{len(hulls)}_{stem}.obj"
                    write_text(draft / hulls[mesh], _hull_of_mesh(mesh))
                target = str((folder / hulls[mesh]).resolve())
            if tree.tag == "mujoco":
                # The default name of a mesh is that of its file.
                element.set("name", element.get("name") or mesh.stem)
                element.set("file", target)
            elif element.tag == "uri":
                element.text = f"file://{target}"
            else:
                element.set("filename", f"file://{target}")
        write_text(draft / model.name, ET.tostring(tree, encoding="unicode"))
    return folder / model.name


def add_hulls(model: Path) -> list[str]:
    """Gives links without collision geometry the convex hull of their visual geometry, in .obj files.

    Links that are welded together get one common hull. Flat geometry gets none.

    Args:
        model: a URDF, SDF or MJCF file that Drake reads; it is overwritten.

    Returns:
        The links with new hulls.

    Raises:
        HandError: the model cannot be loaded.
    """
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=0.001)
    hand = parse_model(plant, model, f"model {model}")
    for constraint in plant.GetConstraintIds():
        plant.RemoveConstraint(constraint)
    plant.Finalize()
    context, inboard, tree = plant.CreateDefaultContext(), inboard_joints(plant), read_model(model)
    changed: list[str] = []
    done: set[BodyIndex] = set()
    for index in plant.GetBodyIndices(hand):
        if index in done:
            continue
        welded = plant.GetBodiesWeldedTo(plant.get_body(index))
        bodies = [body for body in welded if body.model_instance() == hand]
        done |= {body.index() for body in bodies}
        if any(plant.GetCollisionGeometriesForBody(body) for body in bodies):
            continue
        # The link that a joint moves carries the hull for all.
        moved = [body for body in bodies if not isinstance(inboard.get(body.index()), WeldJoint)]
        carrier = (moved or bodies)[0]
        points = [np.empty((0, 3))]
        for body in bodies:
            X_CB = body.body_frame().CalcPose(context, carrier.body_frame())
            parts = link_geometry(plant, scene_graph.model_inspector(), body, Role.kIllustration, X_CB)
            points += [p_CP for *_, p_CP in parts]
        text = _hull_obj(np.concatenate(points))
        if text is None:
            continue
        name = re.sub(r"\W+", "_", f"hull_{len(changed)}_{carrier.name()}")
        file = model.with_name(f"{name}.obj")
        write_text(file, text)
        _add_collision_mesh(tree, carrier.name(), name, file.resolve())
        changed.append(carrier.name())
    if changed:
        write_text(model, ET.tostring(tree, encoding="unicode"))
    return changed


def _add_collision_mesh(tree: ET.Element, link: str, name: str, file: Path) -> None:
    """Adds a mesh as collision geometry of a link, in the link's frame."""
    if tree.tag == "mujoco":
        asset = ET.SubElement(tree, "asset")
        ET.SubElement(asset, "mesh", name=name, file=str(file), scale="1 1 1")
        body = next(body for body in tree.iter("body") if body.get("name") == link)
        ET.SubElement(body, "geom", type="mesh", mesh=name, contype="1", conaffinity="1", group="3")
        return
    owner = next(element for element in tree.iter("link") if element.get("name") == link)
    mesh = ET.SubElement(ET.SubElement(ET.SubElement(owner, "collision", name=name), "geometry"), "mesh")
    if tree.tag == "robot":
        mesh.set("filename", f"file://{file}")
    else:
        ET.SubElement(mesh, "uri").text = f"file://{file}"


def _hull_obj(points: np.ndarray) -> str | None:
    """The convex hull of points (N, 3) as an OBJ file, in their unit; None if it has no finite volume."""
    import trimesh  # few hands need it

    if not len(points) or not np.isfinite(points).all():
        return None
    spread = points - points.mean(axis=0)
    if np.linalg.matrix_rank(spread, tol=_FLATNESS * np.linalg.norm(spread)) < 3:
        return None
    return trimesh.exchange.obj.export_obj(
        trimesh.convex.convex_hull(points),
        include_normals=False,
        include_color=False,
        include_texture=False,
        digits=9,
        header=None,
    )


def _hull_of_mesh(mesh: Path) -> str:
    """The convex hull of a mesh as an OBJ file, in the mesh's unit; of COLLADA in m."""
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
        points = np.asarray(scene.to_mesh().vertices)
        # As in ROS, the unit of a COLLADA file counts, and its up axis does not.
        unit = trimesh.units.unit_conversion(scene.units or "meters", "meters") if suffix == ".dae" else 1.0
    except Exception as error:  # each format raises its own kinds
        raise HandError(f"{mesh}: not a readable {suffix} mesh: {error}") from error
    text = _hull_obj(unit * points @ (_Z_UP.T if suffix == ".glb" else np.eye(3)))
    if text is None:
        raise HandError(
            f"{mesh}: not a readable {suffix} mesh with a volume: it is empty, flat or not finite"
        )
    return text
