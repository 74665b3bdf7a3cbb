"""People do the tasks of a parked hand, and hands that cannot do them are refused."""

import dataclasses as dc

import pytest
from grasp_setup import allegro
from task_bench import attempt

from geort_drake.errors import ScenarioError
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.tasks import find_task

KEYS = "presses: 3, enough: 3, ready_time: 4.0, cue_time: 2.0"


@pytest.mark.parametrize(
    ("task", "method", "kind", "settings", "least", "most"),
    [
        ("keys", "affine_ik", "adaptive", KEYS, 1.0, 1.0),
        ("keys", "affine_ik", "mimicry", KEYS, 1.0, 1.0),
        ("keys", "hold", "servo", KEYS, 0.0, 0.0),
        ("trigger", "affine_ik", "adaptive", "pulls: 1, ready_time: 4.0", 1.0, 1.0),
        ("trigger", "hold", "adaptive", "pulls: 1, ready_time: 4.0", 0.0, 0.0),
        ("cap", "affine_ik", "adaptive", "turn: 60", 1.0, 1.0),
        ("cap", "hold", "adaptive", "turn: 60", 0.0, 0.05),
        ("tracking", "affine_ik", "servo", "targets: 2, enough: 1, ready_time: 5.0", 0.5, 1.0),
        ("tracking", "hold", "servo", "targets: 2, enough: 1, ready_time: 5.0", 0.0, 0.0),
    ],
)
def test_people_do_a_task_through_a_map_that_follows_alone(task, method, kind, settings, least, most):
    """The map is affine; a hand that holds still drops what it holds once the stand lets go."""
    timeout = "timeout: 12, " if task == "cap" else ""
    result, attainable = attempt(task, method, f"{{{timeout}kind: {kind}, task_settings: {{{settings}}}}}")
    assert least <= result.score <= most and result.success == (method == "affine_ik")
    lost = {"trigger": "handle lost", "tracking": "dropped"}
    assert result.outcome == "success" if result.success else result.outcome == lost.get(task, result.outcome)
    assert task != "keys" or attainable == result.success
    assert task != "cap" or not result.success or result.attempts > 1  # 60° are more than one stroke
    assert result.simulated_time > {"trigger": 4.0, "tracking": 5.0}.get(task, 0.0)


@pytest.mark.parametrize(
    ("task", "lacks", "message"),
    [
        ("keys", "ring", "the keys need a ring; hand 'allegro_right' has: thumb, index"),
        ("trigger", "ring", "the trigger needs a ring; hand 'allegro_right' has: thumb, index"),
        ("cap", "thumb", "the cap needs a thumb; hand 'allegro_right' has: index"),
        ("tracking", "thumb", "tracking needs a thumb; hand 'allegro_right' has: index"),
        ("pick_place", "index", "pinch grasp needs a index"),
        ("grasp", "thumb", "a tripod grasp needs a thumb; .* has: index, middle, ring"),
    ],
)
def test_a_hand_without_the_fingers_is_refused_before_it_runs(task, lacks, message):
    hand = allegro().description
    without = dc.replace(hand, fingers=[finger for finger in hand.fingers if finger.name != lacks])
    with pytest.raises(ScenarioError, match=message):
        find_task(task).plans(load_scenario(*find_task(task).scenario), without)
