"""The right hands in models/sdf against their makers' descriptions, data sheets and physics."""

import numpy as np
import pytest
from model_scene import tips_mm
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.resources import models_dir

# Sphere centres in mm, rounded to 0.01 mm, from the manufacturer's description evaluated independently;
# joint_0 to joint_15.
ALLEGRO_TIPS = (
    [0.118, 1.424, 1.287, 0.189, -0.188, 1.382, -0.164, 1.288]
    + [0.279, 0.649, 0.397, 0.287, 0.552, 0.459, 0.736, 0.879],
    {
        "index": [75.31, 49.21, -38.7],
        "middle": [103.08, -19.61, 19.02],
        "ring": [88.27, -25.71, 85.29],
        "thumb": [64.22, 82.19, -9.51],
    },
)
# Centres of the pads' round ends in mm in the published palm frame: x along the fingers, y towards the index
# side, z out of the back; joint_0 to joint_15.
LEAP_TIPS = (
    [1.038, 1.703, 0.982, 2.015, -0.596, 0.094, 0.959, -0.26]
    + [-0.972, 0.996, 0.609, 1.843, 1.188, 1.028, 0.34, -0.543],
    {
        "index": [-47.03, 12.14, -49.18],
        "middle": [79.8, -0.4, -83.79],
        "ring": [-20.78, -71.52, -82.31],
        "thumb": [-79.04, 41.27, -140.49],
    },
)
# That frame in base_link: origin in m, axes as columns.
LEAP_PALM = RigidTransform(RotationMatrix.MakeYRotation(-np.pi / 2), [-0.0187, 0.038, 0.007])


def test_allegro_fingertips_agree_with_the_manufacturers_description(allegro):
    """Exact kinematics reproduce independently computed fingertip points to 0.1 mm."""
    q, wanted = ALLEGRO_TIPS
    for finger, tip in tips_mm(allegro, q).items():
        np.testing.assert_allclose(tip, wanted[finger], atol=0.1)


def test_leap_fingertips_agree_with_the_published_description(leap):
    """Exact kinematics reproduce independently computed fingertip points to 0.1 mm."""
    q, wanted = LEAP_TIPS
    for finger, tip in tips_mm(leap, q).items():
        in_palm = LEAP_PALM.inverse() @ (tip / 1e3)
        np.testing.assert_allclose(in_palm * 1e3, wanted[finger], atol=0.1)


def test_allegro_collides_with_itself_as_often_as_its_meshes_do(allegro, rng):
    """In 34.3 % of uniform joint positions, measured independently with the same primitives."""
    rate = allegro.collides(rng.uniform(allegro.lower, allegro.upper, (20_000, 16))).mean()
    assert rate == pytest.approx(0.3431, abs=0.01)


def test_leap_collides_with_itself_as_often_as_its_meshes_do(leap, rng):
    """In 79.1 % of uniform joint positions, with the meshes in 78.5 %."""
    rate = leap.collides(rng.uniform(leap.lower, leap.upper, (5000, 16))).mean()
    assert rate == pytest.approx(0.7912, abs=0.02)


@pytest.mark.parametrize(
    ("name", "wanted", "speed"),
    [
        ("allegro_right", (1.0, 0.1, 0.7), 7),
        ("allegro_left", (1.0, 0.1, 0.7), 7),
        ("leap_right", (3.0, 0.17, 0.95), 8.48),
    ],
)
def test_hand_actuators_hold_their_position(name, wanted, speed):
    """All sixteen joints have an actuator with implicit PD gains and a torque limit."""
    hand = HandModel(load_hand(name))
    actuators = [hand.plant.get_joint_actuator(index) for index in hand.plant.GetJointActuatorIndices()]
    assert sorted(actuator.joint().name() for actuator in actuators) == sorted(hand.joint_names)
    for actuator in actuators:
        assert actuator.has_controller()
        gains = actuator.get_controller_gains()
        assert (gains.p, gains.d, actuator.effort_limit()) == wanted
        assert actuator.default_gear_ratio() ** 2 * actuator.default_rotor_inertia() == pytest.approx(1e-4)
        assert actuator.joint().velocity_upper_limit() == speed


@pytest.mark.parametrize("name", ["allegro_right", "leap_right"])
def test_the_hand_moves_to_its_desired_positions(name):
    """Under SAP at 2 ms, gravity off, every joint reaches its target within 0.02 rad in 1.5 s."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlant(
        MultibodyPlantConfig(time_step=0.002, discrete_contact_approximation="sap"), builder
    )
    model = HandModel(load_hand(name))
    (hand,) = Parser(plant).AddModels(models_dir() / "sdf" / f"{name}.sdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.set_gravity_enabled(hand, False)
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    start = dict(zip(model.joint_names, model.default_position, strict=True))
    for joint, value in start.items():
        plant.GetJointByName(joint).set_angle(context, value)
    order = [plant.get_joint_actuator(index).joint().name() for index in plant.GetJointActuatorIndices(hand)]
    target = np.array([start[joint] + 0.2 for joint in order])
    plant.get_desired_state_input_port(hand).FixValue(context, np.concatenate([target, 0 * target]))
    simulator.AdvanceTo(1.5)
    reached = np.array([plant.GetJointByName(joint).get_angle(context) for joint in order])
    np.testing.assert_allclose(reached, target, atol=0.02)
