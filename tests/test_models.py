"""The models in models/sdf against their makers' descriptions, data sheets and physics."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from model_scene import OBJECTS, SDF_FILES, SHIPPED_HANDS, Scene
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import Simulator

from geort_drake import Hand
from geort_drake.resources import models_dir
from geort_drake.simulation.object_shape import ObjectShape

SDF = models_dir() / "sdf"
PUBLISHED = yaml.safe_load(Path(__file__).with_name("published_models.yaml").read_text("utf-8"))
# The manufacturer's masses in kg: palm, three fingers and a thumb with four links and a tip each.
ALLEGRO_MASSES = [0.4154, *3 * (0.0119, 0.065, 0.0355, 0.0096, 0.0168), 0.0176, 0.0119, 0.038, 0.0388, 0.0168]


@pytest.mark.parametrize("path", SDF_FILES, ids=lambda path: path.stem)
def test_a_model_is_self_contained_and_physically_possible(path):
    """It parses strictly and refers to no other file; every link has a positive mass and a valid inertia."""
    text = path.read_text(encoding="utf-8").replace("http://drake.mit.edu", "")
    for reference in ("<mesh", "<uri", "package://", "drake_models", "http", "<include"):
        assert reference not in text
    scene = Scene(path)
    bodies = [scene.plant.get_body(BodyIndex(i)) for i in range(1, scene.plant.num_bodies())]
    assert bodies
    for body in bodies:
        assert body.default_mass() > 0, body.name()
        assert body.default_spatial_inertia().IsPhysicallyValid(), body.name()
        assert np.linalg.norm(body.default_com()) < 0.5, body.name()


def test_total_masses_are_those_of_the_hardware(allegro, allegro_left, leap, panda):
    """The hands weigh the sum of the published link masses, the arm 17.99 kg."""
    for hand, mass in ((allegro, sum(ALLEGRO_MASSES)), (allegro_left, sum(ALLEGRO_MASSES)), (leap, 0.746)):
        assert hand.plant.CalcTotalMass(hand.plant.CreateDefaultContext()) == pytest.approx(mass)
    assert panda.plant.CalcTotalMass(panda.context) == pytest.approx(17.99)


@pytest.mark.parametrize("path", OBJECTS, ids=lambda path: path.stem)
def test_objects_stand_on_the_plinth(path):
    """An object released on the plinth moves by less than 1 mm and turns by less than 0.5° in 1 s."""
    scene = Scene(SDF / "plinth.sdf", path, welded=("plinth_base",))
    body = scene.plant.GetBodyByName(path.stem)
    shape = ObjectShape(scene.plant, scene.scene_graph.model_inspector(), body)
    height = 0.1 - shape.lowest_point(RigidTransform())
    start = RigidTransform(RotationMatrix.MakeZRotation(0.3), [0.01, -0.005, height])
    scene.plant.SetFreeBodyPose(scene.context, body, start)
    Simulator(scene.diagram, scene.root).AdvanceTo(1.0)
    moved = start.inverse() @ scene.plant.EvalBodyPoseInWorld(scene.context, body)
    assert np.linalg.norm(moved.translation()) < 1e-3
    assert abs(moved.rotation().ToAngleAxis().angle()) < np.deg2rad(0.5)
    speed = scene.plant.EvalBodySpatialVelocityInWorld(scene.context, body)
    assert np.linalg.norm(speed.translational()) < 1e-3


@pytest.mark.parametrize("name", PUBLISHED["fingertips"])
def test_fingertips_agree_with_the_makers_description(name, request):
    """To 0.1 mm."""
    hand, published = request.getfixturevalue(name), PUBLISHED["fingertips"][name]
    R_BP = RotationMatrix.MakeYRotation(np.deg2rad(published["turn_deg"]))
    X_BP = RigidTransform(R_BP, published["translation"])
    named = {f"joint_{i}": angle for i, angle in enumerate(published["angles"])}
    tips = hand.fingertips(np.array([named[joint] for joint in hand.joint_names]))
    for finger, tip in zip(hand.finger_names, tips, strict=True):
        np.testing.assert_allclose(1e3 * (X_BP.inverse() @ tip), published["tips"][finger], atol=0.1)


@pytest.mark.parametrize(("name", "count", "rate"), [("allegro", 20_000, 0.3431), ("leap", 5000, 0.7912)])
def test_a_hand_collides_with_itself_as_often_as_its_meshes_do(name, count, rate, rng, request):
    """Share of uniform joint positions, measured independently."""
    hand = request.getfixturevalue(name)
    found = hand.collides(rng.uniform(hand.lower, hand.upper, (count, 16))).mean()
    assert found == pytest.approx(rate, abs=1.4 / np.sqrt(count))


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_hand_actuators_reach_and_hold_their_position(name):
    """All sixteen joints have PD gains and a torque limit, and come within 0.02 rad of a target in 1.5 s."""
    scene, model = Scene(SDF / f"{name}.sdf", welded=("base_link",)), Hand(name)
    plant, hand = scene.plant, scene.plant.GetModelInstanceByName(name)
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    order = [actuator.joint().name() for actuator in actuators]
    wanted, speed = ((3.0, 0.17, 0.95), 8.48) if name == "leap_right" else ((1.0, 0.1, 0.7), 7)
    assert sorted(order) == sorted(model.joint_names)
    for actuator in actuators:
        assert actuator.has_controller()
        gains = actuator.get_controller_gains()
        assert (gains.p, gains.d, actuator.effort_limit()) == wanted
        assert actuator.default_gear_ratio() ** 2 * actuator.default_rotor_inertia() == pytest.approx(1e-4)
        assert actuator.joint().velocity_upper_limit() == speed
    plant.gravity_field().set_gravity_vector(np.zeros(3))
    start = dict(zip(model.joint_names, model.default_position, strict=True))
    scene.set_joints(start)
    target = np.array([start[joint] + 0.2 for joint in order])
    plant.get_desired_state_input_port(hand).FixValue(scene.context, np.concatenate([target, 0 * target]))
    Simulator(scene.diagram, scene.root).AdvanceTo(1.5)
    reached = [plant.GetJointByName(joint).get_angle(scene.context) for joint in order]
    np.testing.assert_allclose(reached, target, atol=0.02)


def test_links_of_the_left_allegro_are_those_of_the_right_one_mirrored(allegro, allegro_left):
    """Masses, centres of mass and moments of inertia, negated in y."""
    mirror = np.diag([1.0, -1.0, 1.0])
    for index in allegro.plant.GetBodyIndices(allegro.instance):
        right = allegro.plant.get_body(index)
        number = right.name().removeprefix("link_")
        if number.isdigit() and int(number) < 12:  # the left hand's fingers are numbered the other way
            number = 8 - 4 * (int(number) // 4) + int(number) % 4
            left = allegro_left.plant.GetBodyByName(f"link_{number}")
        else:
            left = allegro_left.plant.GetBodyByName(right.name())
        assert left.default_mass() == right.default_mass()
        np.testing.assert_allclose(left.default_com(), mirror @ right.default_com(), atol=1e-9)
        inertias = (body.default_spatial_inertia().CalcRotationalInertia() for body in (left, right))
        inertia, expected = (of_body.CopyToFullMatrix3() for of_body in inertias)
        np.testing.assert_allclose(inertia, mirror @ expected @ mirror, rtol=1e-9, atol=1e-15)


def test_panda_agrees_with_its_denavit_hartenberg_table(panda, rng):
    """The flange's pose is the product of Franka's link transforms, for any joint positions."""
    for q in rng.uniform(-2, 2, (20, 7)):
        panda.set_joints({f"panda_joint{i + 1}": angle for i, angle in enumerate(q)})
        X = RigidTransform()
        for (a, d, alpha), theta in zip(PUBLISHED["panda"], [*q, 0.0], strict=True):
            X = X @ RigidTransform(RotationMatrix.MakeXRotation(np.deg2rad(alpha)), [a, 0, 0])
            X = X @ RigidTransform(RotationMatrix.MakeZRotation(theta), [0, 0, d])
        flange = panda.plant.GetFrameByName("panda_link8").CalcPoseInWorld(panda.context)
        np.testing.assert_allclose(flange.GetAsMatrix4(), X.GetAsMatrix4(), atol=1e-9)


def test_panda_actuators_hold_their_position(panda):
    """All seven joints have the stiffness of the arm's own controller, and settle without swinging."""
    ready = [0.0, -0.7854, 0.0, -2.35619, 0.0, 1.5708, 0.7854]
    panda.set_joints({f"panda_joint{i + 1}": angle for i, angle in enumerate(ready)})
    inertia = panda.plant.CalcMassMatrix(panda.context)
    assert panda.plant.num_actuators() == 7
    for i, stiffness in enumerate([3000, 3000, 3000, 2500, 2500, 2000, 2000]):
        actuator = panda.plant.GetJointActuatorByName(f"panda_joint{i + 1}")
        gains = actuator.get_controller_gains()
        assert gains.p == stiffness
        row = actuator.joint().velocity_start()
        assert 0.7 < gains.d / (2 * np.sqrt(gains.p * inertia[row, row])) < 1.4
