"""Every shipped hand on the arm, left hands as mirror images, and hands on a floating or a fixed base."""

import dataclasses as dc

import numpy as np
import pytest
from grasp_setup import Constant, allegro, centred_map, person_who_plays, reach_goal, resting_glove, started
from model_scene import SHIPPED_HANDS
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake import Hand, load_hand, load_retargeter, load_scenario, make_trial_diagram, run_trial
from geort_drake.errors import HandError
from geort_drake.people.keypoints import mirrored
from geort_drake.simulation.object_shape import ObjectShape
from geort_drake.simulation.plan.contacts import GRIPS, grip_contacts
from geort_drake.simulation.plan.grasp import GraspPlanner
from geort_drake.simulation.trial import after_play, seen_fingertips, select_reachable
from geort_drake.simulation.world import HAND, add_object, add_robot
from geort_drake.systems.port_values import pose_to_vector

M = np.diag([1.0, -1.0, 1.0, 1.0])


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_a_hand_sits_on_the_adapter_and_touches_nothing(name):
    """The mount's frame lies on the adapter's hand side; arm and hand start without contact."""
    builder, description = DiagramBuilder(), load_hand(name)
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.002)
    add_robot(plant, load_scenario(hand=name), description)
    plant.Finalize()
    diagram, hand = builder.Build(), plant.GetModelInstanceByName(HAND)
    root = diagram.CreateDefaultContext()
    context = plant.GetMyContextFromRoot(root)
    assert not plant.get_geometry_query_input_port().Eval(context).HasCollisions()
    mount = description.mount
    X_AM = plant.GetFrameByName(mount.frame, hand).CalcPose(context, plant.GetFrameByName("hand_side"))
    wanted = RigidTransform(RollPitchYaw(np.deg2rad(mount.rpy_deg)), mount.translation)
    np.testing.assert_allclose(X_AM.GetAsMatrix4(), wanted.GetAsMatrix4(), atol=1e-12)
    # The palm looks at the object, from before it.
    X_WB = plant.GetFrameByName(description.base_frame, hand).CalcPoseInWorld(context)
    to_object = np.array([0.5, 0.0, 0.2]) - X_WB.translation()
    assert X_WB.rotation().matrix()[:, 0] @ to_object > 0.05


@pytest.mark.parametrize("grip", GRIPS)
@pytest.mark.parametrize("name", ["cylinder", "wide_box"])
def test_a_left_hands_contacts_are_mirrored(grip, name):
    """At the opposite yaw a left hand's contacts are a right one's with y negated."""
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=0.0)
    shape = ObjectShape(plant, scene_graph.model_inspector(), add_object(plant, name))
    yaw = 0.0 if name == "wide_box" else 0.4
    of_right, of_left = grip_contacts(shape, yaw, 0.5, grip), grip_contacts(shape, -yaw, 0.5, grip, "left")
    for right, left in zip(of_right, of_left, strict=True):
        assert right.part == left.part
        np.testing.assert_allclose(left.p_OC, mirrored(right.p_OC), atol=1e-12)
        np.testing.assert_allclose(left.n_O, mirrored(right.n_O), atol=1e-12)


def test_a_left_hand_is_simulated_as_the_mirror_image():
    """With the same person, seed and map, the left hand moves as the right one's mirror image.

    Not to the last digit, as the arm's inverse kinematics is solved to a tolerance. When the person's fingers
    meet, at 1 s, such a difference decides whether they stick to each other or slide.
    """
    poses, angles, gloves = [], [], []
    still = "position_range: 0, yaw_range: 0, mass_range: 0"
    for name, aim in (("allegro_right", reach_goal()), ("allegro_left", reach_goal().mirrored())):
        scenario = load_scenario(text=f"{{hand: {name}, object: {{{still}}}}}")
        model = Hand(name)
        parts = make_trial_diagram(scenario, centred_map(model), (person_who_plays(), aim))
        simulator = started(parts)
        root = simulator.get_context()
        context = parts.plant.GetMyContextFromRoot(root)
        hand = parts.plant.GetModelInstanceByName(HAND)
        base = parts.plant.GetFrameByName(parts.description.base_frame, hand)
        before = base.CalcPoseInWorld(context)
        simulator.AdvanceTo(0.7)
        poses.append((before, base.CalcPoseInWorld(context)))
        angles.append([parts.plant.GetJointByName(j, hand).get_angle(context) for j in model.joint_names])
        glove = parts.operator.GetOutputPort("keypoints")
        gloves.append(glove.Eval(parts.operator.GetMyContextFromRoot(root)))
    (before, after), (_, after_left) = poses
    assert np.linalg.norm(after.translation() - before.translation()) > 0.05
    np.testing.assert_allclose(after_left.GetAsMatrix4(), M @ after.GetAsMatrix4() @ M, atol=0.01)
    opposite = np.where(np.isin(model.joint_names, ["joint_0", "joint_4", "joint_8"]), -1, 1)  # spread
    np.testing.assert_allclose(angles[1] * opposite, angles[0], atol=0.02)
    # Both persons are described as right hands.
    np.testing.assert_allclose(gloves[1], gloves[0], atol=2e-3)


@pytest.mark.slow
def test_leap_grasps():
    """The simulated person lifts the object with the planned contacts and the hand's own gains."""
    text = "{object: {name: cube}, task_settings: {hold_time: 0.5}, timeout: 15.0}"
    scenario, hand = load_scenario(hand="leap_right", text=text), Hand("leap_right")
    person, retarget = person_who_plays(), centred_map(hand)
    plans = GraspPlanner(scenario, hand.description).plans(2)
    goal, _ = select_reachable(plans, seen_fingertips(retarget, hand, person))
    result, _ = run_trial(scenario, retarget, (person, goal))
    assert result.success and result.attempts == 1


def test_a_map_of_another_hand_is_refused():
    scenario, person = load_scenario(hand="leap_right"), person_who_plays()
    retarget = after_play(load_retargeter("allegro_right"), person)
    with pytest.raises(HandError, match="for allegro_right, not for the robot hand leap_right"):
        run_trial(scenario, retarget, (person, reach_goal()))


@pytest.mark.parametrize("name", ["Floating", "Fixed"])
def test_without_an_arm_the_hand_follows_the_wrist_or_its_fingers_alone_move(name):
    """A floating base 5 cm up and to the side, and 0.3 rad about the vertical, to 2 mm and 0.02 rad.

    A fixed base does not move at all with the wrist; the fingers follow.
    """
    glove = resting_glove(1.5)
    part = np.clip(glove.t / 0.8, 0.0, 1.0)
    wrist = [RigidTransform(RollPitchYaw(0, 0, 0.3 * s), [0, 0.05 * s, 0.05 * s]) for s in part]
    glove = dc.replace(glove, X_WH=np.array([pose_to_vector(X) for X in wrist]))
    middle = Constant(q=0.5 * (allegro().lower + allegro().upper))
    parts = make_trial_diagram(load_scenario(name=name), middle, glove)
    simulator = started(parts)
    hand = parts.plant.GetModelInstanceByName(HAND)
    base = parts.plant.GetFrameByName("base_link", hand)
    context = parts.plant.GetMyContextFromRoot(simulator.get_context())
    before, q = base.CalcPoseInWorld(context), parts.plant.GetPositions(context, hand)
    simulator.AdvanceTo(1.5)
    after = base.CalcPoseInWorld(context)
    if name == "Fixed":
        moved = parts.plant.GetPositions(context, hand) - q
        assert after.IsExactlyEqualTo(before) and np.abs(moved).max() > 0.2
        return
    np.testing.assert_allclose(after.translation() - before.translation(), [0, 0.05, 0.05], atol=0.002)
    turned = after.rotation() @ before.rotation().inverse()
    wanted = RollPitchYaw(0, 0, 0.3).ToRotationMatrix()
    np.testing.assert_allclose(turned.matrix(), wanted.matrix(), atol=0.02)
