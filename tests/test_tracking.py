"""In-grasp tracking: its grips and targets, its judgement, and people who move the puck."""

import math

import numpy as np
import pytest
from grasp_setup import allegro
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from task_bench import judged, plans

from geort_drake.live.robots import SimulatedRobot
from geort_drake.live.web.scene import PoseStream, Scene
from geort_drake.people.keypoints import mirrored
from geort_drake.simulation.following import RobotModel
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.tasks.tracking.goal import RADIUS, targets
from geort_drake.simulation.tasks.tracking.monitor import TrackingMonitor, TrackingOutcome, TrackingSettings
from geort_drake.simulation.tasks.tracking.planner import TrackingPlanner
from geort_drake.systems.port_values import pose_to_vector

X_WG = RigidTransform(RotationMatrix.MakeYRotation(0.4), [0.5, 0.0, 0.3])
CUED = (5, 6)  # 10 mm along the axis, and 20° about x


def outcome_of(path: list[RigidTransform], tolerance: float = 0.003, begins: float = 0.0) -> TrackingOutcome:
    """The judgement of a puck on lines between poses in the grip, 10 a second from the first cue on.

    The task is restarted at `begins`, s.
    """
    rules = TrackingSettings(targets=2, enough=2, target_time=2.0, ready_time=0.5, distance=tolerance)
    poses = np.array([pose_to_vector(X_WG @ X_GO) for X_GO in path])
    t = begins + 0.5 + 0.1 * np.arange(len(path))
    return judged(TrackingMonitor(4, X_WG, CUED, rules), begins + 5.0, begins, object_pose=(t, poses))


GRIP, UP, TURNED = RigidTransform(), targets()[CUED[0]], targets()[CUED[1]]
ROLLED = TURNED @ RigidTransform(RotationMatrix.MakeZRotation(1.0))


@pytest.mark.parametrize(
    ("path", "reached"),
    [
        ([GRIP, *[UP] * 8, *[TURNED] * 40], 2),
        ([GRIP, *[UP] * 8, *[ROLLED] * 40], 2),  # the puck is round
        ([GRIP, *[UP] * 40], 1),
        ([GRIP, *[RigidTransform([0, 0, 0.006])] * 10, *[UP] * 30], 1),  # too far; later the other is cued
        ([GRIP, *[UP, UP, UP, GRIP] * 5, *[TURNED] * 30], 1),  # not long enough at a time
    ],
)
def test_a_target_counts_once_the_puck_stays_there(path, reached):
    outcome = outcome_of(path)
    assert (outcome.reached, outcome.score, outcome.success) == (reached, reached / 2, reached == 2)
    assert outcome.over and not outcome.is_dropped


def test_time_and_difficulty_of_a_target():
    """A way of 10 mm to within 3 mm either way, and one of 20° to within 6°."""
    outcome = outcome_of([GRIP, *[UP] * 7, *[TURNED] * 40])
    assert outcome.times[0] == pytest.approx(0.1 * 0.7 + 0.5, abs=0.03)
    assert outcome.bits == pytest.approx(math.log2(1 + 10 / 6) + math.log2(1 + 20 / 12), abs=0.02)
    assert outcome.completion_time == pytest.approx(0.5 + sum(outcome.times), abs=0.03)


def test_a_restarted_task_is_judged_alike_by_the_simulations_clock():
    path = [GRIP, *[UP] * 7, *[TURNED] * 40]
    before, later = outcome_of(path), outcome_of(path, begins=2.0)
    np.testing.assert_allclose(later.times, before.times, atol=1e-9)
    assert later.completion_time == pytest.approx(2.0 + before.completion_time)


def test_the_page_draws_the_puck_a_second_time_at_its_target(monkeypatch):
    """Translucent; in the grip before the first cue, and then elsewhere."""
    found = plans("tracking")
    monkeypatch.setattr(TrackingPlanner, "plans", lambda _: found)
    scenario = load_scenario(*find_task("tracking").scenario, "{task_settings: {ready_time: 0.05}}")
    description = allegro().description
    robot = SimulatedRobot(scenario, description, RobotModel(scenario, description))
    plant, target = robot.stage.scene.plant, robot.stage.target
    graph = robot.stage.scene.scene_graph
    scene = Scene(plant, graph.model_inspector(), description, parked=True, target=target.body)
    names = scene.description["moving"]
    looks = {
        name: [look for look in scene.description["geometries"] if look["moving"] == names.index(name)]
        for name in ("puck::puck", "target")
    }
    assert [look["size"] for look in looks["target"]] == [look["size"] for look in looks["puck::puck"]]
    assert {look["color"][3] for look in looks["target"]} == {0.35}
    builder = DiagramBuilder()
    builder.AddNamedSystem("robot", robot.diagram)
    frames = []
    stream = builder.AddSystem(PoseStream(scene, lambda: None, "right", frames.append))
    for name in ("body_poses", "target_pose"):
        builder.Connect(robot.diagram.GetOutputPort(name), stream.GetInputPort(name))
    for group in (robot.hand, robot.arm):
        held = np.concatenate([group.start, np.zeros_like(group.start)])
        port = robot.diagram.GetInputPort(f"{group.name}_desired_state")
        builder.Connect(builder.AddSystem(ConstantVectorSource(held)).get_output_port(), port)
    simulator = Simulator(builder.Build())
    robot.initialize(simulator.get_mutable_context())
    simulator.AdvanceTo(0.1)
    before, after = (np.frombuffer(frames[number], "<f4")[1:-63].reshape(-1, 7)[-1] for number in (0, -1))
    X_WG = plant.GetDefaultFloatingBaseBodyPose(target.body)
    np.testing.assert_allclose(before, pose_to_vector(X_WG), atol=1e-6)
    assert min(np.abs(after - pose_to_vector(X_WG @ X_GT)).max() for X_GT in targets()) < 1e-6


def test_a_dropped_puck_ends_the_trial():
    outcome = outcome_of([GRIP, *[UP] * 8, RigidTransform([0.05, 0, 0]), *[TURNED] * 40])
    assert outcome.is_dropped and outcome.over and not outcome.success
    assert outcome.reached == 1 and outcome.t < 1.6


def test_every_plan_holds_the_puck_and_reaches_the_targets():
    """Within 2 mm, with joints inside their limits."""
    hand = allegro()
    planner = TrackingPlanner(hand.description)
    for plan in (plans("tracking")[0], plans("tracking")[-1]):
        goal = plan.goal
        off = (goal.X_BG.inverse().multiply(goal.p_BF_touch.T).T)[goal.touches]
        np.testing.assert_allclose(np.linalg.norm(off[:, :2], axis=1), RADIUS + hand.tip_radius, atol=1e-9)
        np.testing.assert_allclose(off[:, 2], 0.0, atol=1e-9)
        tips = hand.fingertips(plan.q_open)
        np.testing.assert_allclose(tips[goal.touches], goal.p_BF_open[goal.touches], atol=2e-3)
        assert len(goal.places()) == 11
        for p_BF in goal.places():
            q = planner.reach(p_BF[goal.touches], plan.q_open)
            assert q is not None and np.all((hand.lower < q) & (q < hand.upper))


def test_the_mirror_has_the_same_places():
    """In another order: targets to either side change places."""
    goal = plans("tracking")[0].goal
    seen = goal.mirrored().places()
    for place in map(mirrored, goal.places()):
        assert min(np.abs(place - other).max() for other in seen) < 1e-9
