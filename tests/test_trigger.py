"""The task of the trigger: its places, its judgement, its people, and that the stand lets go."""

import numpy as np
import pytest
from grasp_setup import allegro
from task_bench import judged, plans

from geort_drake.simulation.tasks.trigger.goal import RADIUS
from geort_drake.simulation.tasks.trigger.monitor import TriggerMonitor, TriggerOutcome, TriggerSettings
from geort_drake.simulation.tasks.trigger.planner import HOVER


def outcome_of(travel: list[float], moved: float = 0.0) -> TriggerOutcome:
    """The judgement of the pad's travel, m at 10 Hz from the first cue on; the handle moves within 1 s."""
    rules = TriggerSettings(pulls=2, hold_time=0.5, ready_time=0.5, settle_time=0.5)
    pose = np.zeros((2, 7))
    pose[:, 0], pose[1, 6] = 1.0, moved
    return judged(
        TriggerMonitor(4, rules),
        until=1.0 + 0.1 * len(travel),
        joints=(1.0 + 0.1 * np.arange(len(travel)), np.column_stack([travel, np.zeros(len(travel))])),
        object_pose=([1.0, 2.0], pose),
    )


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


def test_every_plan_holds_the_handle_between_palm_and_fingers():
    """And brings the fingertips where the goal says."""
    hand = allegro()
    for plan in (plans("trigger")[0], plans("trigger")[-1]):
        goal = plan.goal
        off = goal.p_BF_open - goal.p_BH
        off[:, 1] = 0.0
        holding = goal.touches & (np.arange(4) != goal.trigger)
        np.testing.assert_allclose(
            np.linalg.norm(off, axis=1)[holding], RADIUS + hand.tip_radius + HOVER, atol=1e-6
        )
        tips = hand.fingertips(plan.q_open)
        np.testing.assert_allclose(tips[goal.touches], goal.p_BF_open[goal.touches], atol=2e-3)
