"""Free play: which plan the person keeps, and that nobody approaches what the fingers cannot reach."""

import dataclasses as dc
from functools import cache

import numpy as np
from grasp_setup import allegro, centred_map, person_who_plays, planned_goal, scenario_with

from geort_drake.retargeting.methods import make_untrained
from geort_drake.simulation.free_play import keep_reached, seen_fingertips
from geort_drake.simulation.operators.perception import FreePlay
from geort_drake.simulation.operators.state import Phase
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.trial import run_trial


def moved(goal: GraspGoal, shift: float) -> GraspGoal:
    """The grasp with its open fingertips shifted."""
    return dc.replace(goal, p_BF_open=goal.p_BF_open + [0.0, 0.0, shift])


@cache
def play() -> FreePlay:
    return seen_fingertips(centred_map(), allegro(), person_who_plays())


def test_the_first_plan_that_free_play_reaches_is_kept():
    """Within its clearance; if none is, the nearest, with any error; unseen, the first."""
    seen = play()
    near = dc.replace(planned_goal("cylinder"), p_BF_open=seen.p_BF[0], clearance=0.01)
    far, farther = moved(near, 0.3), moved(near, 0.5)
    kept, attainable = keep_reached([far, near, moved(near, 0.0)], seen)
    assert attainable and kept.p_BF_open is near.p_BF_open and kept.clearance == 0.01
    for plans, frames in (([farther, far], seen), ([far, near], seen._replace(p_BF=seen.p_BF[:0]))):
        kept, attainable = keep_reached(plans, frames)
        assert not attainable and kept.p_BF_open is far.p_BF_open and kept.clearance == np.inf


def test_free_play_shows_where_the_robots_fingertips_go():
    """They move through a map, stay with one that holds, and are not seen with one that fails."""
    person = person_who_plays()
    seen = play().p_BF
    assert seen.std(axis=0).min() > 1e-3 and len(seen) == 900
    still = seen_fingertips(make_untrained("hold", allegro().kinematics()), allegro(), person).p_BF
    assert still.std(axis=0).max() < 1e-9

    def failing(_):
        raise ArithmeticError

    failing.joint_names = allegro().joint_names
    assert len(seen_fingertips(failing, allegro(), person).p_BF) == 0


def test_nobody_approaches_farther_off_than_the_clearance():
    """An open hand out of reach is waited for until the timeout; with room for the error, it is not."""
    scenario = scenario_with("cylinder", "{timeout: 3.5, operator: {visual_depth_noise: 0.002}}")
    unreachable = moved(planned_goal("cylinder"), 0.04)
    phases = [
        run_trial(scenario, centred_map(), (person_who_plays(), dc.replace(unreachable, clearance=room)))[0]
        for room in (0.012, 0.1)
    ]
    assert phases[0].operator_phase == Phase.REACH.name.lower()
    assert phases[1].operator_phase != Phase.REACH.name.lower()
