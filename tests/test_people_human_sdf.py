"""The SDF model of a human hand: the same hand as the numeric one, and physically possible."""

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake.people.human_hand import HumanHand
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.resources import models_dir

MODEL = models_dir() / "sdf" / "human_right.sdf"
KEYPOINT_FRAMES = ["wrist"] + [
    f"{finger}_{name}"
    for finger in FINGER_NAMES
    for name in (("cmc", "mcp", "ip", "tip") if finger == "thumb" else ("mcp", "pip", "dip", "tip"))
]


def build(text):
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
    Parser(plant).AddModelsFromString(text, "sdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("palm"))
    plant.Finalize()
    return plant, builder.Build()


def drake_keypoints(plant, context, hand, theta):
    for name, angle in zip(hand.joint_names, theta, strict=True):
        plant.GetJointByName(name).set_angle(context, angle)
    return np.stack(
        [plant.GetFrameByName(name).CalcPoseInWorld(context).translation() for name in KEYPOINT_FRAMES]
    )


def test_drake_and_numpy_place_the_keypoints_alike(rng):
    """Drake's kinematics of the SDF and the closed form agree to 1e-6 m."""
    hand = HumanHand.anatomical()
    plant, diagram = build(MODEL.read_text())
    context = plant.GetMyContextFromRoot(diagram.CreateDefaultContext())
    for theta in rng.uniform(hand.lower, hand.upper, (20, 20)):
        error = drake_keypoints(plant, context, hand, theta) - hand.keypoints(theta)
        assert np.abs(error).max() < 1e-6


def test_limits_of_the_model_are_those_of_the_hand():
    """Joint limits in the SDF equal the numeric hand's."""
    hand = HumanHand.anatomical()
    plant, _ = build(MODEL.read_text())
    joints = [plant.GetJointByName(name) for name in hand.joint_names]
    np.testing.assert_allclose([joint.position_lower_limit() for joint in joints], hand.lower, atol=1e-8)
    np.testing.assert_allclose([joint.position_upper_limit() for joint in joints], hand.upper, atol=1e-8)
    assert plant.num_positions() == 20


def test_inertias_are_physical_and_a_hand_weighs_about_400_grams():
    """Every link's inertia is valid; the whole is 0.3 to 0.6 kg (0.6 % of 50 to 100 kg, de Leva 1996)."""
    plant, diagram = build(MODEL.read_text())
    context = diagram.CreateDefaultContext()
    masses = []
    for index in plant.GetBodyIndices(plant.GetModelInstanceByName("human_right")):
        inertia = plant.get_body(index).default_spatial_inertia()
        assert inertia.IsPhysicallyValid()
        masses.append(inertia.get_mass())
    assert len(masses) == 1 + 5 * 4
    assert min(masses) > 1e-3
    assert 0.3 < sum(masses) < 0.6
    assert np.isfinite(plant.CalcMassMatrix(plant.GetMyContextFromRoot(context))).all()


def test_an_open_hand_does_not_touch_itself():
    """With straight fingers no two bodies that could collide are in contact."""
    plant, diagram = build(MODEL.read_text())
    root = diagram.CreateDefaultContext()
    context = plant.GetMyContextFromRoot(root)
    plant.SetPositions(context, np.zeros(20))
    plant.GetJointByName("little_mcp_abduction").set_angle(context, -0.2)
    assert not plant.get_geometry_query_input_port().Eval(context).HasCollisions()
