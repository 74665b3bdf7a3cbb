"""Shapes, contacts and planned grasps, against Drake's own geometry queries."""

import itertools
import math

import numpy as np
import pytest
from grasp_execution import execute
from grasp_setup import allegro, planned_goal, scenario_with
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, QueryObject, Role, Shape, Sphere
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import ScenarioError, UnknownNameError
from geort_drake.hands.description import load_hand
from geort_drake.simulation.object_shape import ObjectShape, object_shape
from geort_drake.simulation.scenario import object_names
from geort_drake.simulation.tasks.grasp.approach import GraspApproach
from geort_drake.simulation.tasks.grasp.contacts import (
    GRIPS,
    contact_heights,
    finger_offsets,
    grip_contacts,
    grip_of,
    palm_contact,
    vertical_extent,
    yaw_candidates,
)
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner
from geort_drake.simulation.world import HAND, add_object, add_robot

TIP_RADIUS = 0.012


# -- the shape of an object


def ball_points(count: int = 601) -> np.ndarray:
    """Points all over the unit sphere, (N, 3)."""
    polar, around = np.meshgrid(np.linspace(0, np.pi, count), np.linspace(0, 2 * np.pi, 2 * count))
    return np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1
    ).reshape(-1, 3)


def surface_points(shape: Shape) -> np.ndarray:
    """Points (N, 3) of a shape's surface that come close to its lowest point in any pose."""
    if isinstance(shape, Box):
        return np.array(np.meshgrid(*[[-h, h] for h in shape.size() / 2])).reshape(3, -1).T
    if isinstance(shape, Cylinder):
        around = np.linspace(0, 2 * np.pi, 20_001)
        rim = shape.radius() * np.stack([np.cos(around), np.sin(around), 0 * around], axis=-1)
        return np.concatenate([rim + [0, 0, z] for z in (-shape.length() / 2, shape.length() / 2)])
    if isinstance(shape, Capsule):
        ball = shape.radius() * ball_points()
        return np.concatenate([ball + [0, 0, z] for z in (-shape.length() / 2, shape.length() / 2)])
    if isinstance(shape, Ellipsoid):
        return ball_points() * [shape.a(), shape.b(), shape.c()]
    return shape.radius() * ball_points()


@pytest.mark.parametrize(
    "shape",
    [
        Box(0.04, 0.07, 0.11),
        Cylinder(0.03, 0.1),
        Capsule(0.02, 0.08),
        Ellipsoid(0.02, 0.05, 0.09),
        Sphere(0.03),
    ],
    ids=lambda shape: type(shape).__name__,
)
def test_the_lowest_point_is_that_of_dense_surface_samples(shape, rng):
    """In random poses, and off the object's origin, no surface point is lower, and one is as low."""
    points = surface_points(shape)
    for _ in range(5):
        X_OG, X_WO = (
            RigidTransform(RollPitchYaw(*rng.uniform(-np.pi, np.pi, 3)), rng.normal(0, 0.2, 3))
            for _ in range(2)
        )
        lowest = (X_WO @ X_OG).multiply(points.T)[2].min()
        assert ObjectShape(((shape, X_OG),)).lowest_point(X_WO) == pytest.approx(lowest, abs=3e-6)
        assert ObjectShape(((shape, X_OG),)).lowest_point(X_WO) <= lowest + 1e-12


def test_the_lowest_of_several_parts_counts():
    """An object is as low as its lowest part, and its main part is the largest."""
    ball = (Sphere(0.01), RigidTransform([0, 0, -0.2]))
    box = (Box(0.1, 0.1, 0.1), RigidTransform([0, 0, 0.05]))
    shape = ObjectShape((ball, box))
    assert shape.main[0] is box[0]
    assert shape.lowest_point(RigidTransform()) == pytest.approx(-0.21)
    upside_down = RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0, 0, 0])
    assert shape.lowest_point(upside_down) == pytest.approx(-0.1)
    assert vertical_extent(shape) == pytest.approx((-0.21, 0.1))


@pytest.mark.parametrize(
    ("collision", "message"),
    [
        ("", r"object 'thing' needs collision geometry .* it has: none"),
        (
            "<collision name='m'><geometry><plane><normal>0 0 1</normal></plane></geometry></collision>",
            r"made of Box, Capsule, .* it has: HalfSpace",
        ),
    ],
)
def test_an_object_without_usable_geometry_is_refused_by_name(collision, message):
    """The message names the object, the shapes that can be used, and those it has."""
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    sdf = f"<sdf version='1.11'><model name='thing'><link name='thing'>{collision}</link></model></sdf>"
    Parser(plant).AddModelsFromString(sdf, "sdf")
    with pytest.raises(ScenarioError, match=message):
        object_shape(plant, scene_graph.model_inspector(), plant.GetBodyByName("thing"))


# -- contacts


class ObjectAlone:
    """One object with its frame O at the world's origin."""

    def __init__(self, name: str):
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        body = add_object(plant, name)
        plant.WeldFrames(plant.world_frame(), body.body_frame())
        plant.Finalize()
        self.shape = object_shape(plant, scene_graph.model_inspector(), body)
        self._diagram = builder.Build()  # keeps what the query refers to
        self._root = self._diagram.CreateDefaultContext()
        self._query = query_of(plant, self._root)

    def distance(self, p_O: np.ndarray) -> float:
        """Signed distance of a point from the object, m."""
        return min(near.distance for near in self._query.ComputeSignedDistanceToPoint(p_O))


def query_of(plant: MultibodyPlant, root) -> QueryObject:
    return plant.get_geometry_query_input_port().Eval(plant.GetMyContextFromRoot(root))


@pytest.mark.parametrize("name", object_names())
def test_contacts_lie_on_the_surface_and_point_inwards(name):
    """At every yaw, height and room tried, a fingertip at its contact touches the object within 2 mm."""
    thing, grip = ObjectAlone(name), grip_of(name)
    yaws, symmetry = yaw_candidates(thing.shape)
    assert symmetry in (0.0, math.pi / 2, math.pi)
    heights = contact_heights(thing.shape, grip, TIP_RADIUS)
    assert heights and yaws
    bottom, _ = vertical_extent(thing.shape)
    for height, yaw, offset in itertools.product(heights, yaws, finger_offsets(thing.shape, grip)):
        contacts = grip_contacts(thing.shape, yaw, height, grip, offset=offset)
        assert [contact.part for contact in contacts] == list(GRIPS[grip].fingers)
        for contact in (*contacts, palm_contact(thing.shape, yaw, height)):
            assert np.linalg.norm(contact.n_O) == pytest.approx(1)
            assert abs(contact.n_O[2]) < 1e-12
            assert contact.p_OC[2] - bottom >= TIP_RADIUS - 1e-9 or contact.part == "palm"
            tip = contact.p_OC - TIP_RADIUS * contact.n_O
            assert thing.distance(tip) == pytest.approx(TIP_RADIUS, abs=2e-3)
            # Further along the normal the tip comes nearer to the object, or is inside.
            assert thing.distance(tip + 0.005 * contact.n_O) < thing.distance(tip) - 0.002


@pytest.mark.parametrize("name", object_names())
def test_the_thumb_opposes_the_fingers(name):
    """Along the grip's axis thumb and fingers push against each other; into the palm all push alike."""
    shape, grip = ObjectAlone(name).shape, grip_of(name)
    for yaw in yaw_candidates(shape)[0]:
        axis = np.array([math.cos(yaw), math.sin(yaw), 0])
        across = np.array([-math.sin(yaw), math.cos(yaw), 0])
        thumb, *fingers = grip_contacts(shape, yaw, grip=grip)
        assert thumb.n_O @ axis > 0.8
        pushes = np.array([finger.n_O for finger in fingers])
        assert (pushes @ axis < -0.7).all()
        assert all((finger.p_OC - thumb.p_OC) @ axis > 0 for finger in fingers)  # it is between them
        if GRIPS[grip].palm:
            palm = palm_contact(shape, yaw, 0.5)
            assert (np.array([thumb.n_O, *pushes]) @ palm.n_O < -0.4).all()
            np.testing.assert_allclose(palm.n_O, across, atol=1e-9)
        else:
            np.testing.assert_allclose(thumb.n_O, axis, atol=1e-9)
            np.testing.assert_allclose(pushes.sum(axis=0) @ across, 0, atol=1e-9)


def test_heights_where_the_fingers_find_no_room_are_left_out():
    """Contacts stay on the object's main part, and above what the fingertips need."""
    can = ObjectShape(((Cylinder(0.03, 0.2), RigidTransform()),))
    everywhere = contact_heights(can, "tripod", 0.014)
    assert min(everywhere) < 0.5 < max(everywhere)
    assert set(contact_heights(can, "tripod", 0.1)) == {share for share in everywhere if share >= 0.5}
    # Ring and index finger need 4 cm below and above the middle one.
    low = ObjectShape(((Cylinder(0.03, 0.1), RigidTransform()),))
    assert contact_heights(low, "power", 0.014) == [0.55]
    assert contact_heights(ObjectShape(((Cylinder(0.03, 0.07), RigidTransform()),)), "power", 0.0) == []
    # A ball is taken at its middle, as its surface is upright nowhere else, or not at all.
    ball = ObjectShape(((Sphere(0.01), RigidTransform()),))
    assert contact_heights(ball, "pinch", 0.01) == [0.5]
    assert contact_heights(ball, "pinch", 0.011) == []


def test_fingers_beside_each_other_get_more_room_on_flat_sides_that_have_it():
    """Two fingers on a wide box, not on a narrow one nor on a can; a finger alone needs none."""

    def apart(shape: ObjectShape, grip: str) -> list[float]:
        found = []
        for offset in finger_offsets(shape, grip):
            _, *fingers = grip_contacts(shape, 0.0, grip=grip, offset=offset)
            found.append(float(np.ptp([finger.p_OC[1] for finger in fingers])))
        return found

    wide, narrow = (ObjectShape(((Box(0.03, width, 0.1), RigidTransform()),)) for width in (0.05, 0.03))
    can = ObjectShape(((Cylinder(0.03, 0.1), RigidTransform()),))
    assert apart(wide, "tripod") == sorted(set(apart(wide, "tripod")))
    assert min(apart(wide, "tripod")) > 0.024 and 0.03 < max(apart(wide, "tripod")) < 0.05
    assert len(apart(narrow, "tripod")) == len(apart(can, "tripod")) == len(apart(wide, "pinch")) == 1


def test_every_object_has_a_grip_and_an_unlisted_one_is_refused_by_name():
    """All three grips occur; the message lists the objects."""
    assert {grip_of(name) for name in object_names()} == set(GRIPS) == {"pinch", "tripod", "power"}
    with pytest.raises(UnknownNameError, match=r"unknown object in .*objects\.yaml 'chair'.*ball_small"):
        grip_of("chair")


# -- the way to the grasp


def approach(X_OB_start: RigidTransform, name: str = "can_heavy") -> GraspApproach:
    hand = allegro()
    angles = dict(zip(hand.joint_names, hand.default_position, strict=True))
    return GraspApproach(hand.description, name, X_OB_start, angles)


def test_the_hand_waits_where_it_gets_to_without_touching_the_object():
    """From above and behind it waits straight behind the grasp; from the other side it must not."""
    hand = allegro()
    angles = dict(zip(hand.joint_names, hand.default_position, strict=True))
    # The palm faces the can along x, the fingers point along y.
    R = RotationMatrix(np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]))
    X_OB = RigidTransform(R, [-0.10, -0.04, 0.0])
    behind = approach(RigidTransform(R, [-0.4, -0.04, 0.0])).waiting_pose(X_OB, angles)
    assert behind is not None
    np.testing.assert_allclose(behind.rotation().matrix(), R.matrix(), atol=1e-12)
    np.testing.assert_allclose(behind.translation(), [-0.18, -0.04, 0.0], atol=1e-12)
    # Through the can there is no way, and beneath it none either.
    beyond = approach(RigidTransform(R, [0.3, -0.04, 0.0])).waiting_pose(X_OB, angles)
    assert beyond is None
    assert approach(RigidTransform(R, [0.0, 0.0, 0.0])).waiting_pose(X_OB, angles) is None
    # A grasp inside the object cannot be approached from anywhere.
    inside = RigidTransform(R, [0.0, 0.0, 0.0])
    assert approach(RigidTransform(R, [-0.4, -0.04, 0.0])).waiting_pose(inside, angles) is None


# -- plans


@pytest.mark.parametrize("name", ["cylinder", "block_tiny", "can_heavy"])
def test_a_planned_grasp_touches_and_nothing_collides(name):
    """In the planned posture, in a plant without collision filters, only fingertips meet the object."""
    scenario, description = scenario_with(name), load_hand("allegro_right")
    planner = GraspPlanner(scenario, description)
    goal = planner.plan()
    # The whole posture is no part of the goal.
    planned = planner._kinematics.joint_positions(planner._search().q_touch)
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    add_robot(plant, scenario, description)
    body = add_object(plant, name)
    lowest = object_shape(plant, scene_graph.model_inspector(), body).lowest_point(RigidTransform())
    plant.Finalize()
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    for name_of_joint, angle in planned.items():
        joint = plant.GetJointByName(name_of_joint)
        joint.set_angle(context, angle)
        low, high = joint.position_lower_limit(), joint.position_upper_limit()
        assert low - 1e-6 <= angle <= high + 1e-6, name_of_joint
    # The object where the goal has it in the hand is the object on its support, but for some clearance.
    hand = plant.GetModelInstanceByName(HAND)
    X_WB = plant.GetFrameByName(description.base_frame, hand).CalcPoseInWorld(context)
    X_WO = X_WB @ goal.X_OB.inverse()
    standing = [*scenario.object.position, scenario.object.support_height - lowest]
    np.testing.assert_allclose(X_WO.rotation().matrix(), np.eye(3), atol=1e-9)
    raised = X_WO.translation() - standing
    np.testing.assert_allclose(raised[:2], 0, atol=1e-9)
    assert abs(raised[2]) < 0.01
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, body, X_WO)

    inspector = scene_graph.model_inspector()
    query = query_of(plant, root)
    tip_links = {finger.tip_link for finger in description.fingers}

    def body_of(geometry):
        return plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))

    for pair in query.ComputePointPairPenetration():
        a, b = body_of(pair.id_A), body_of(pair.id_B)
        if body in (a, b):
            other = b if a == body else a
            resting = other.name() == "plinth_base" and pair.depth < 1e-6 - raised[2]
            touching = other.name() in tip_links and pair.depth < 2e-3
            assert resting or touching, f"{a.name()} in {b.name()} by {pair.depth}"
        elif "plinth_base" in (a.name(), b.name()):
            # The planner sinks the object, and the hand with it; below it is seen that nothing meets.
            assert pair.depth < -raised[2], f"{a.name()} in {b.name()} by {pair.depth}"
        else:
            assert {a.name(), b.name()} <= tip_links, f"{a.name()} in {b.name()} by {pair.depth}"
    # With the object on its support, the hand does not meet what the object stands on either, and
    # fingertips only nearly.
    for pair in query.ComputeSignedDistancePairwiseClosestPoints(0.02):
        bodies = {body_of(pair.id_A), body_of(pair.id_B)}
        models = {plant.GetModelInstanceName(one.model_instance()) for one in bodies}
        if HAND in models and models & {"table", "plinth"}:
            tip = any(one.name() in tip_links for one in bodies)
            assert pair.distance - raised[2] > (1e-3 if tip else 7e-3), models

    surface = set(inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(body.index()), Role.kProximity))
    for number, finger in enumerate(description.fingers):
        tip = plant.GetBodyByName(finger.tip_link, hand).EvalPoseInWorld(context) @ np.array(finger.tip_point)
        np.testing.assert_allclose(tip, X_WO @ goal.p_OF_touch[number], atol=1e-6)
        near = query.ComputeSignedDistanceToPoint(tip)
        gap = min(found.distance for found in near if found.id_G in surface) - finger.tip_radius
        if goal.touches[number]:
            assert gap == pytest.approx(0, abs=2e-3), finger.name
        else:
            assert gap > 2e-3, finger.name

    # The goal itself.
    assert goal.finger_names == ("thumb", "index", "middle", "ring")
    wanted = GRIPS[grip_of(body.name())].fingers
    assert goal.touches.tolist() == [finger in wanted for finger in goal.finger_names]
    for values in (goal.p_BF_open, goal.p_OF_touch, goal.n_OF, goal.X_OB.GetAsMatrix4()):
        assert np.isfinite(values).all()
    np.testing.assert_allclose(np.linalg.norm(goal.n_OF, axis=1), goal.touches)
    # Before the grasp the hand is back along its palm's normal or above, and the fingers are further out.
    back = goal.X_OB_before.translation() - goal.X_OB.translation()
    np.testing.assert_allclose(
        goal.X_OB_before.rotation().matrix(), goal.X_OB.rotation().matrix(), atol=1e-12
    )
    rise = back + np.outer(np.linspace(0.08, 0.2, 13), goal.X_OB.rotation().matrix()[:, 0])
    assert np.abs(rise[:, :2]).max(axis=1).min() < 1e-9 and np.linalg.norm(back) > 0.05
    opened = goal.X_OB.multiply(goal.p_BF_open.T).T - goal.p_OF_touch
    assert ((opened * goal.n_OF).sum(axis=1)[goal.touches] < -0.01).all()


@pytest.mark.parametrize("name", object_names())
def test_planned_grasps_hold_when_executed_directly(name):
    """Closing, squeezing by 20 mm and lifting by inverse kinematics holds the object 10 cm up.

    There is neither operator nor retargeter, so a failure is the planner's or the object's.
    """
    done = execute(scenario_with(name), allegro(), planned_goal(name), squeeze=0.02)
    assert done.height > 0.10
    assert done.slip < 0.03
    touching = done.force[:-1] > 0.1
    assert touching[planned_goal(name).touches].sum() >= 2


def test_a_heavy_object_falls_without_a_squeeze():
    """The test above can fail: fingertips that stop 5 mm off the surface lift nothing."""
    done = execute(scenario_with("can_heavy"), allegro(), planned_goal("can_heavy"), squeeze=-0.005)
    assert done.height < 0.02


def test_the_plan_is_the_same_every_time():
    """Two planners come to the same goal, to the last bit."""
    first, again = (GraspPlanner(scenario_with("sphere"), allegro().description).plan() for _ in range(2))
    np.testing.assert_array_equal(first.X_OB.GetAsMatrix4(), again.X_OB.GetAsMatrix4())
    np.testing.assert_array_equal(first.p_OF_touch, again.p_OF_touch)


def test_an_object_out_of_reach_is_refused_by_name():
    """The message names the object and where it is."""
    scenario = scenario_with("sphere", "object: { position: [1.6, 0.0] }")
    with pytest.raises(ScenarioError, match=r"cannot grasp object 'sphere' at \[1\.6, 0\.0\]"):
        GraspPlanner(scenario, allegro().description).plan()


def test_a_hand_without_a_thumb_is_refused_by_name():
    """A tripod needs a thumb."""
    description = load_hand("allegro_right")
    description.fingers = description.fingers[1:]
    with pytest.raises(
        ScenarioError, match=r"a tripod grasp needs a thumb; hand 'allegro_right' has: index, middle, ring"
    ):
        GraspPlanner(scenario_with("cube"), description)
