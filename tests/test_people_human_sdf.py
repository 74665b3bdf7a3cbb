"""The human hand as an SDF model: the same hand as the numeric one, and physically possible."""

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake.people.human_hand import HumanHand
from geort_drake.people.human_hand_sdf import human_hand_sdf
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.play import synthesize_play
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


@pytest.mark.parametrize("kind", ["anatomical", "fitted"])
def test_drake_and_numpy_place_the_keypoints_alike(kind, rng):
    """Drake's kinematics of the SDF and the closed form agree to 1e-6 m, for a fitted hand too."""
    if kind == "anatomical":
        hand, text = HumanHand.anatomical(), MODEL.read_text()
    else:
        play = synthesize_play(1, duration_s=60.0, hand=HumanHand.anatomical(0.17, 0.075))
        hand = HumanHand.fit(play)
        text = human_hand_sdf(hand, "somebody")
    plant, diagram = build(text)
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


def test_the_file_is_what_the_hand_gives():
    """models/sdf/human_right.sdf is the text made from the anatomical hand, number for number."""
    assert MODEL.read_text() == human_hand_sdf(HumanHand.anatomical(), "human_right")


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


def test_a_finger_bone_has_the_inertia_of_its_capsule(rng):
    """Mass, centre and inertia of one link match a Monte Carlo integral over its capsule."""
    plant, _ = build(MODEL.read_text())
    body = plant.GetBodyByName("middle_proximal")
    inertia = body.default_spatial_inertia()
    radius, length, density = 0.0095, HumanHand.anatomical().lengths[2, 0], 1100.0
    low = np.array([-radius, -radius, -radius])
    high = np.array([radius, radius, length + radius])
    p = rng.uniform(low, high, (400_000, 3))
    nearest = np.column_stack([np.zeros((len(p), 2)), p[:, 2].clip(0, length)])
    inside = p[np.linalg.norm(p - nearest, axis=1) < radius]
    mass = density * np.prod(high - low) * len(inside) / len(p)
    r = inside - inside.mean(axis=0)
    moments = mass * (np.mean(r**2, axis=0).sum() - np.mean(r**2, axis=0))
    assert inertia.get_mass() == pytest.approx(mass, rel=0.01)
    np.testing.assert_allclose(inertia.get_com(), inside.mean(axis=0), atol=2e-4)
    about_centre = inertia.Shift(inertia.get_com()).CalcRotationalInertia().get_moments()
    np.testing.assert_allclose(about_centre, moments, rtol=0.02)


def test_an_open_hand_does_not_touch_itself():
    """With straight fingers no two bodies that could collide are in contact."""
    plant, diagram = build(MODEL.read_text())
    root = diagram.CreateDefaultContext()
    context = plant.GetMyContextFromRoot(root)
    plant.SetPositions(context, np.zeros(20))
    plant.GetJointByName("little_mcp_abduction").set_angle(context, -0.2)
    assert not plant.get_geometry_query_input_port().Eval(context).HasCollisions()
