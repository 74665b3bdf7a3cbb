"""The task of the trigger: its places, its judgement, its people, and that the stand lets go."""

import dataclasses as dc

import numpy as np
import pytest
from grasp_setup import allegro, person_who_plays
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from geort_drake.errors import ScenarioError
from geort_drake.people.play import synthesize_play
from geort_drake.retargeting.methods import make_untrained
from geort_drake.simulation.free_play import seen_fingertips
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.tasks.trigger.goal import RADIUS
from geort_drake.simulation.tasks.trigger.monitor import TriggerMonitor, TriggerOutcome, TriggerSettings
from geort_drake.simulation.tasks.trigger.planner import HOVER, TriggerPlanner
from geort_drake.simulation.trial import run_trial


@pytest.fixture(scope="module")
def plans():
    return TriggerPlanner(allegro().description).plans()


def outcome_of(travel: list[float], moved: float = 0.0) -> TriggerOutcome:
    """The judgement of the pad's travel, m at 10 Hz from the first cue on; the handle moves within 1 s."""
    rules = TriggerSettings(pulls=2, hold_time=0.5, ready_time=0.5, settle_time=0.5)
    builder = DiagramBuilder()
    monitor = builder.AddSystem(TriggerMonitor(4, rules))
    t = 1.0 + 0.1 * np.arange(len(travel))
    pad = PiecewisePolynomial.FirstOrderHold(t, np.array([travel, np.zeros(len(travel))]))
    pose = np.tile([[1.0], [0], [0], [0], [0], [0], [0]], 2)
    pose[6, 1] = moved
    sources = {
        "pad": TrajectorySource(pad),
        "object_pose": TrajectorySource(PiecewisePolynomial.FirstOrderHold([1.0, 2.0], pose)),
        "contact": ConstantVectorSource(np.zeros(4)),
        "self_contact": ConstantVectorSource(np.zeros(1)),
    }
    for name, source in sources.items():
        builder.Connect(builder.AddSystem(source).get_output_port(), monitor.GetInputPort(name))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.0 + 0.1 * len(travel))
    return monitor.outcome(monitor.GetMyContextFromRoot(simulator.get_context()))


PULL = [0.0, *[0.004] * 7, 0.0, 0.0]


@pytest.mark.parametrize(
    ("travel", "done"),
    [
        (PULL + PULL, 2),
        (PULL + [0.0] * 10, 1),
        (PULL + [0.0, *[0.006] * 7, 0.0, 0.0], 1),  # too far
        (PULL + [0.0, *[0.004, 0.004, 0.004, 0.001] * 2, 0.0], 1),  # not long enough at a time
        (PULL[:-2] + [0.002] * 12, 0),  # not released
    ],
)
def test_a_pull_counts_once_the_pad_was_held_and_released(travel, done):
    outcome = outcome_of(travel)
    assert (outcome.done, outcome.score, outcome.success) == (done, done / 2, done == 2)


def test_a_handle_that_moves_is_lost():
    assert outcome_of(PULL + PULL, moved=0.009).success
    outcome = outcome_of(PULL + PULL, moved=0.02)
    assert outcome.is_lost and outcome.over and not outcome.success and outcome.t < 1.6


def test_every_plan_holds_the_handle_between_palm_and_fingers(plans):
    """And brings the fingertips where the goal says."""
    hand = allegro()
    for plan in (plans[0], plans[-1]):
        goal = plan.goal
        off = goal.p_BF_open - goal.p_BH
        off[:, 1] = 0.0
        holding = goal.touches & (np.arange(4) != goal.trigger)
        np.testing.assert_allclose(
            np.linalg.norm(off, axis=1)[holding], RADIUS + hand.tip_radius + HOVER, atol=1e-6
        )
        tips = hand.fingertips(plan.q_open)
        np.testing.assert_allclose(tips[goal.touches], goal.p_BF_open[goal.touches], atol=2e-3)


def test_a_hand_without_the_fingers_is_refused_before_it_runs():
    description = dc.replace(allegro().description, fingers=allegro().description.fingers[:3])
    with pytest.raises(
        ScenarioError, match="the trigger needs a ring; hand 'allegro_right' has: thumb, index"
    ):
        TriggerPlanner(description)


@pytest.mark.parametrize(("method", "score"), [("affine_ik", 1.0), ("hold", 0.0)])
def test_people_pull_through_a_map_that_follows_alone(method, score, plans):
    """The map is affine; a hand that holds still lets the handle fall once the stand lets go."""
    person = person_who_plays()
    frames = synthesize_play(seed=0, duration_s=60).fingertips([4, 8, 12, 16])
    retarget = make_untrained(method, allegro().kinematics(), frames=frames)
    play = seen_fingertips(retarget, allegro(), person)
    goal, _ = find_task("trigger").keep([plan.goal for plan in plans], play)
    scenario = load_scenario(*find_task("trigger").scenario, "{task_settings: {pulls: 1, ready_time: 4.0}}")
    result, _ = run_trial(scenario, retarget, (person, goal))
    assert (result.score, result.success) == (score, score == 1.0)
    assert result.outcome == ("success" if score else "handle lost") and result.simulated_time > 4.0
