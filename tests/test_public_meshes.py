"""Panda and Allegro drawn in the meshes of Drake's public models: of stand-ins, as there is no network."""

import math

import numpy as np
import pytest
from pydrake.geometry import Mesh, Role
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import ScenarioError
from geort_drake.resources import models_dir
from geort_drake.simulation.public_meshes import HANDS, PANDA, wear_public_meshes

OBJ = "v 0 0 0\nv 0.01 0 0\nv 0 0.01 0\nv 0 0 0.01\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
INERTIAL = "<inertial><mass>1</mass></inertial>"
VISUAL = "<visual name='seen'>{}<geometry><mesh><uri>package://drake_models/part.obj</uri></mesh></geometry></visual>"
# Index and palm of the public right Allegro: its own figures, which are our base_link's moved by 95 mm.
ALLEGRO = f"""<sdf version="1.7"><model name="allegro_hand_right">
  <link name="hand_root">{INERTIAL}{VISUAL.format("<pose>0 0 0.095 0 0 0</pose>")}</link>
  <link name="link_0"><pose>0 0.0435 0.093458 -0.087267 0 0</pose>{INERTIAL}{VISUAL.format("")}</link>
  <link name="link_1"><pose>0 0.044929 0.109796 -0.087267 0 0</pose>{INERTIAL}</link>
  <joint name="joint_0" type="revolute"><parent>hand_root</parent><child>link_0</child>
    <axis><xyz expressed_in="__model__">0 0.087156 0.996195</xyz></axis></joint>
  <joint name="joint_1" type="revolute"><parent>link_0</parent><child>link_1</child>
    <axis><xyz expressed_in="__model__">0 0.996195 -0.087156</xyz></axis></joint>
</model></sdf>"""
# Two links of Franka's arm, as in its data sheet.
PANDA_URDF = """<robot name="panda">
  <link name="panda_link0"><visual><origin rpy="1.57079632679 0 0"/>
    <geometry><mesh filename="package://drake_models/part.obj"/></geometry></visual></link>
  <link name="panda_link1"><visual>
    <geometry><mesh filename="package://drake_models/part.obj"/></geometry></visual></link>
  <joint name="panda_joint1" type="revolute"><origin xyz="0 0 0.333"/><parent link="panda_link0"/>
    <child link="panda_link1"/><axis xyz="0 0 1"/>
    <limit effort="87" lower="-2.9" upper="2.9" velocity="2"/></joint>
</robot>"""


@pytest.fixture
def drake_models(tmp_path, monkeypatch):
    """A folder that stands for a user's copy of `drake_models`."""
    folder = tmp_path / "drake_models"
    for file, text in (
        (HANDS["allegro_right"], ALLEGRO),
        (PANDA, PANDA_URDF),
        ("part.obj", OBJ),
        ("package.xml", "<package format='2'><name>drake_models</name></package>"),
    ):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text(text)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    return folder


def robot(name):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.002)
    (model,) = Parser(plant).AddModels(str(models_dir() / "sdf" / f"{name}.sdf"))
    plant.Finalize()
    return builder, plant, scene_graph, model


def seen(plant, scene_graph, link):
    inspector = scene_graph.model_inspector()
    frame = plant.GetBodyFrameIdOrThrow(plant.GetBodyByName(link).index())
    return inspector, inspector.GetGeometries(frame, Role.kIllustration)


@pytest.mark.parametrize(
    ("name", "file", "poses"),
    [
        (
            "allegro_right",
            HANDS["allegro_right"],
            {"base_link": RigidTransform(), "link_0": RigidTransform()},
        ),
        (
            "panda",
            PANDA,
            {
                "panda_link0": RigidTransform(RollPitchYaw(math.pi / 2, 0, 0), np.zeros(3)),
                "panda_link1": RigidTransform(),
            },
        ),
    ],
)
def test_links_wear_the_public_meshes_where_these_belong(drake_models, name, file, poses):
    _, plant, scene_graph, model = robot(name)
    wear_public_meshes(plant, scene_graph, model, file)
    for link, X_BG in poses.items():
        inspector, (geometry,) = seen(plant, scene_graph, link)
        assert isinstance(inspector.GetShape(geometry), Mesh)
        assert inspector.GetPoseInFrame(geometry).IsNearlyEqualTo(X_BG, 1e-5)


def test_other_links_and_all_that_collides_stay(drake_models):
    _, plain, plain_scene, _ = robot("allegro_right")
    _, plant, scene_graph, model = robot("allegro_right")
    wear_public_meshes(plant, scene_graph, model, HANDS["allegro_right"])
    for link in ("link_1", "link_3", "link_15"):
        assert len(seen(plant, scene_graph, link)[1]) == len(seen(plain, plain_scene, link)[1])
    for body in map(plant.get_body, plant.GetBodyIndices(model)):
        assert len(plant.GetCollisionGeometriesForBody(body)) == len(
            plain.GetCollisionGeometriesForBody(plain.GetBodyByName(body.name()))
        )


def test_a_model_of_another_robot_is_refused(drake_models):
    _, plant, scene_graph, model = robot("allegro_right")
    file = drake_models / HANDS["allegro_right"]
    file.write_text(ALLEGRO.replace("0.044929 0.109796", "0.044929 0.119796"))
    with pytest.raises(ScenarioError, match="has link 'link_1' elsewhere"):
        wear_public_meshes(plant, scene_graph, model, HANDS["allegro_right"])
    with pytest.raises(ScenarioError, match="no link of franka"):
        wear_public_meshes(plant, scene_graph, model, PANDA)


def test_meshes_that_cannot_be_had_are_named(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    (tmp_path / "package.xml").write_text("<package format='2'><name>drake_models</name></package>")
    _, plant, scene_graph, model = robot("panda")
    with pytest.raises(
        ScenarioError, match=r"public_meshes: drake_models/franka.* cannot be had.*ROS_PACKAGE_PATH"
    ):
        wear_public_meshes(plant, scene_graph, model, PANDA)
