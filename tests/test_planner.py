"""Shapes, contacts and planned grasps, against Drake's own geometry queries."""

import itertools
import math

import numpy as np
import pytest
from grasp_setup import allegro, planned_grasp, scenario_with
from hand_family import HandSpec, write_hand
from model_scene import Scene
from pydrake.geometry import QueryObject, Role
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from geort_drake import load_hand
from geort_drake.errors import ScenarioError, UnknownNameError
from geort_drake.hands.importers.proposal import propose
from geort_drake.resources import object_names
from geort_drake.simulation.object_shape import ObjectShape
from geort_drake.simulation.person.perception import FreePlay
from geort_drake.simulation.plan.contacts import (
    GRIPS,
    contact_heights,
    finger_offsets,
    grip_contacts,
    grip_of,
    vertical_extent,
    yaw_candidates,
)
from geort_drake.simulation.plan.grasp import GraspPlanner
from geort_drake.simulation.plan.kinematics import GraspKinematics
from geort_drake.simulation.scenario import object_file
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.trial import select_reachable
from geort_drake.simulation.world import HAND, add_object, add_robot

TIP_RADIUS = 0.012
# Least height of a fingertip's centre above the support, m, as the planner has it.
LOWEST = TIP_RADIUS + 0.002
SMALL = ("battery_aa", "die", "nut_m8", "pen")


class ObjectAlone(Scene):
    """One object with its frame O at the world's origin."""

    def __init__(self, name: str):
        super().__init__(object_file(name), welded=(name,))
        body = self.plant.GetBodyByName(name)
        self.shape = ObjectShape(self.plant, self.scene_graph.model_inspector(), body)

    def distance(self, p_O: np.ndarray) -> float:
        """Signed distance of a point from the object, m."""
        near = query_of(self.plant, self.root).ComputeSignedDistanceToPoint(p_O)
        return min(found.distance for found in near)


def query_of(plant: MultibodyPlant, root) -> QueryObject:
    return plant.get_geometry_query_input_port().Eval(plant.GetMyContextFromRoot(root))


@pytest.mark.parametrize("name", object_names())
def test_contacts_lie_on_the_surface_and_point_inwards(name):
    """At every candidate, a fingertip at its contact touches the object within 2 mm."""
    thing, grip = ObjectAlone(name), grip_of(name)
    yaws, _ = yaw_candidates(thing.shape)
    heights = contact_heights(thing.shape, grip, LOWEST)
    assert heights and yaws
    bottom, _ = vertical_extent(thing.shape)
    for height, yaw, offset in itertools.product(heights, yaws, finger_offsets(thing.shape, grip)):
        contacts = grip_contacts(thing.shape, yaw, height, grip, offset=offset)
        assert [contact.part for contact in contacts] == [*GRIPS[grip], *["palm"] * (grip == "power")]
        for contact in contacts:
            assert np.linalg.norm(contact.n_O) == pytest.approx(1) and abs(contact.n_O[2]) < 1e-12
            assert contact.p_OC[2] - bottom >= TIP_RADIUS - 1e-9 or contact.part == "palm"
            tip = contact.p_OC - TIP_RADIUS * contact.n_O
            assert thing.distance(tip) == pytest.approx(TIP_RADIUS, abs=2e-3)
            # Further along the normal the tip comes nearer to the object, or is inside.
            assert thing.distance(tip + 0.005 * contact.n_O) < thing.distance(tip) - 0.002


@pytest.mark.parametrize("name", ["cylinder", "cube", "bottle"])
def test_contacts_of_adjacent_fingers_can_be_as_close_as_the_fingers(name):
    """The thumb's stays where it is."""
    thing, grip = ObjectAlone(name), grip_of(name)
    usual, close = (grip_contacts(thing.shape, 0.0, 0.5, grip, spacing=gap) for gap in (math.inf, 0.02))
    np.testing.assert_allclose(usual[0].p_OC, close[0].p_OC, atol=1e-12)
    for contact, after in itertools.pairwise(close[1 : len(GRIPS[grip])]):
        assert np.linalg.norm(contact.p_OC - after.p_OC) == pytest.approx(0.02, abs=2e-3)
        assert thing.distance(contact.p_OC) == pytest.approx(0.0, abs=1e-4)


def test_every_object_has_a_grip_and_one_unlisted_or_out_of_reach_is_refused_by_name():
    """All three grips occur; the message lists the objects."""
    assert {grip_of(name) for name in object_names()} == set(GRIPS) == {"pinch", "tripod", "power"}
    with pytest.raises(UnknownNameError, match=r"unknown object in .*objects\.yaml 'chair'.*ball_small"):
        grip_of("chair")
    scenario = scenario_with("sphere", "object: { position: [1.6, 0.0] }")
    with pytest.raises(ScenarioError, match=r"cannot grasp object 'sphere' at \[1\.6, 0\.0\]"):
        GraspPlanner(scenario, allegro().description).plans(2)[0]


@pytest.mark.parametrize(
    ("there", "reached"),
    [
        pytest.param([0.45, -0.15, 0.015], True, id="on the table"),
        pytest.param([0.45, -0.15, -0.1], False, id="below it", marks=pytest.mark.slow),
        pytest.param([1.1, -0.15, 0.015], False, id="out of reach", marks=pytest.mark.slow),
    ],
)
def test_the_arm_reaches_the_place_of_a_planned_object_or_the_place_is_refused(there, reached):
    """Without collisions, so that a place below the table top is none."""
    scenario = load_scenario(task="pick_place")
    planner = GraspPlanner(scenario, allegro().description, "pinch", 0.016, RigidTransform(there))
    if reached:
        assert planner.plans(1)
    else:
        with pytest.raises(ScenarioError, match=r"with which the arm reaches the place at \["):
            planner.plans(1)


def test_an_object_too_low_for_a_hands_fingertips_is_refused_before_the_trial():
    """Spheres of Ø 36 mm have their centres at least 6.5 mm above the upper edge of the die."""
    description = load_hand("allegro_right")
    for finger in description.fingers:
        finger.tip_radius = 0.018
    with pytest.raises(ScenarioError, match=r"'die' .*: it is 12\.0 mm high, too low for .* 20\.0 mm above"):
        GraspPlanner(scenario_with("die"), description).plans(2)


@pytest.mark.parametrize(
    "name",
    ["cylinder", "block_tiny", "can_heavy", *(pytest.param(name, marks=pytest.mark.slow) for name in SMALL)],
)
def test_a_planned_grasp_touches_and_nothing_collides(name):
    """In the planned posture, in a plant without collision filters, only fingertips meet the object."""
    scenario, description = scenario_with(name), load_hand("allegro_right")
    goal, planned = planned_grasp(name)
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    add_robot(plant, scenario, description)
    body = add_object(plant, name)
    lowest = ObjectShape(plant, scene_graph.model_inspector(), body).lowest_point(RigidTransform())
    plant.Finalize()
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    for name_of_joint, angle in planned.items():
        joint = plant.GetJointByName(name_of_joint)
        joint.set_angle(context, angle)
        low, high = joint.position_lower_limit(), joint.position_upper_limit()
        assert low - 1e-6 <= angle <= high + 1e-6, name_of_joint
    # The planner sinks the object into its support; here the object stands where the goal has it in the hand.
    hand = plant.GetModelInstanceByName(HAND)
    X_WB = plant.GetFrameByName(description.base_frame, hand).CalcPoseInWorld(context)
    X_WO = X_WB @ goal.X_OB.inverse()
    standing = [*scenario.object.position, scenario.object.support_height - lowest]
    *aside, sunk = standing - X_WO.translation()
    assert np.abs(aside).max() < 1e-9 and 0 < sunk < 0.01
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, body, X_WO)

    inspector, query = scene_graph.model_inspector(), query_of(plant, root)
    tip_links = {finger.tip_link for finger in description.fingers}

    def body_of(geometry):
        return plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))

    for pair in query.ComputePointPairPenetration():
        a, b = body_of(pair.id_A), body_of(pair.id_B)
        if "plinth_base" in (a.name(), b.name()):
            allowed = sunk + 1e-6
        elif body in (a, b):
            allowed = 2e-3 if (b if a == body else a).name() in tip_links else 0.0
        else:
            allowed = math.inf if {a.name(), b.name()} <= tip_links else 0.0
        assert pair.depth < allowed, f"{a.name()} in {b.name()} by {pair.depth}"

    surface = set(inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(body.index()), Role.kProximity))
    grasping = GRIPS[grip_of(name)]
    assert goal.touches.tolist() == [finger in grasping for finger in goal.finger_names]
    for number, finger in enumerate(description.fingers):
        tip = plant.GetBodyByName(finger.tip_link, hand).EvalPoseInWorld(context) @ np.array(finger.tip_point)
        np.testing.assert_allclose(tip, X_WO @ goal.p_OF_touch[number], atol=1e-6)
        near = query.ComputeSignedDistanceToPoint(tip)
        gap = min(found.distance for found in near if found.id_G in surface) - finger.tip_radius
        assert gap == pytest.approx(0, abs=2e-3) if goal.touches[number] else gap > 2e-3, finger.name
    # Before the grasp the hand is away from the object, and its fingers are further out.
    assert np.linalg.norm(goal.X_OB_before.translation() - goal.X_OB.translation()) > 0.05
    opened = goal.X_OB.multiply(goal.p_BF_open.T).T - goal.p_OF_touch
    assert ((opened * goal.n_OF).sum(axis=1)[goal.touches] < -0.01).all()


def test_a_hand_that_cannot_take_an_object_into_its_palm_holds_it_by_a_tripod(monkeypatch):
    """The can, once no posture brings it to the palm."""
    touch = GraspKinematics.touch

    def without_palm(self, contacts, *rest, **options):
        palm = contacts[-1].part == "palm"
        return None if palm else touch(self, contacts, *rest, **options)

    monkeypatch.setattr(GraspKinematics, "touch", without_palm)
    monkeypatch.setattr("geort_drake.simulation.plan.grasp._TRIES", 4)
    goal = GraspPlanner(scenario_with("bottle"), allegro().description).plans(2)[0]
    assert goal.touches.tolist() == [True, True, True, False]


def test_links_that_are_close_at_rest_do_not_forbid_every_posture():
    """Hulls of described hands overlap; here two fingers cross in the default posture."""
    description = load_hand("allegro_right")
    description.default_positions |= {"joint_0": -0.45, "joint_4": 0.45}
    robot = GraspKinematics(scenario_with("cylinder"), description, ["thumb", "index"])
    query = query_of(robot._plant, robot._context)
    assert not query.ComputeSignedDistancePairwiseClosestPoints(1e-4)


@pytest.mark.parametrize("name", ["cube", pytest.param("bottle", marks=pytest.mark.slow)])
def test_a_hand_with_a_forearm_and_close_fingers_that_cannot_spread_grasps(name, tmp_path, monkeypatch):
    """Its fingers bend in one plane; the forearm is thicker than the palm and lies on the arm."""
    monkeypatch.setattr("geort_drake.simulation.plan.grasp._TRIES", 4)
    narrow = {'lower="-0.3" upper="0.3"': 'lower="-0.01" upper="0.01"'}
    model = write_hand(tmp_path, HandSpec(5, "urdf", mimic=True, forearm=0.2), changes=narrow)
    description = propose(model)[0]
    assert description.mount.translation == pytest.approx([0, 0, 0.2], abs=2e-3)
    goal = GraspPlanner(scenario_with(name), description).plans(2)[0]
    assert goal.touches[:2].all()


def test_a_person_who_cannot_show_the_widest_opening_gets_one_that_they_can():
    """Of a hand whose index finger has two joints; all openings clear the object."""
    description = load_hand("allegro_right")
    description.fingers[1].joints = ["joint_1", "joint_2"]
    goals = GraspPlanner(scenario_with("cylinder"), description, "pinch").plans(1)
    assert np.ptp([goal.p_BF_open[0] for goal in goals], axis=0).max() > 0.05
    for goal in (goals[0], goals[-1]):
        assert 0.01 < goal.clearance < np.inf
        kept, attainable = select_reachable(goals, FreePlay(goal.p_BF_open[None], goal.p_BF_open[None]))
        assert attainable and np.linalg.norm(kept.p_BF_open[0] - goal.p_BF_open[0]) <= kept.clearance
