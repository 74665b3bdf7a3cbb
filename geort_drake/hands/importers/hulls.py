"""Collision geometry for links that have none: the convex hulls of what is drawn of them."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
from pydrake.geometry import Role
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex, WeldJoint
from pydrake.systems.framework import DiagramBuilder

from geort_drake.files import write_text
from geort_drake.hands.assembly import parse_model
from geort_drake.hands.couplings import model_tree
from geort_drake.hands.importers.tip_points import link_points
from geort_drake.hands.links import inboard_joints
from geort_drake.hands.meshes import hull_obj


def add_hulls(model: Path) -> list[str]:
    """Gives links that are drawn and touch nothing a hull, in .obj files beside the model.

    Links that are welded together get one hull for all, if none of them has collision geometry and what is
    drawn of them is not flat.

    Args:
        model: a URDF, SDF or MJCF file that Drake reads, which is replaced; see `convert_model` for a copy.

    Returns:
        The links that carry a new hull.

    Raises:
        HandError: the model cannot be loaded.
    """
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=0.001)
    hand = parse_model(plant, model, f"model {model}")
    for constraint in plant.GetConstraintIds():
        plant.RemoveConstraint(constraint)
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    context = plant.CreateDefaultContext()
    inboard = inboard_joints(plant)
    tree = model_tree(model)
    given: list[str] = []
    done: set[BodyIndex] = set()
    for index in plant.GetBodyIndices(hand):
        if index in done:
            continue
        welded = plant.GetBodiesWeldedTo(plant.get_body(index))
        bodies = [body for body in welded if body.model_instance() == hand]
        done |= {body.index() for body in bodies}
        # The link that a joint moves, and the others with it.
        carrier = next(
            (body for body in bodies if not isinstance(inboard.get(body.index()), WeldJoint)), bodies[0]
        )
        if any(plant.GetCollisionGeometriesForBody(body) for body in bodies):
            continue
        points = [np.empty((0, 3))]
        for body in bodies:
            X_CB = body.body_frame().CalcPose(context, carrier.body_frame())
            points += link_points(plant, inspector, body, Role.kIllustration, X_CB)
        text = hull_obj(np.concatenate(points))
        if text is None:
            continue
        name = re.sub(r"\W+", "_", f"hull_{len(given)}_{carrier.name()}")
        file = model.with_name(f"{name}.obj")
        write_text(file, text)
        _insert(tree, carrier.name(), name, file.resolve())
        given.append(carrier.name())
    if given:
        write_text(model, ET.tostring(tree, encoding="unicode"))
    return given


def _insert(tree: ET.Element, link: str, name: str, file: Path) -> None:
    """The mesh as collision geometry of the link, in the link's frame."""
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
