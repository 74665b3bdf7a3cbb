"""Pick and place: its judgement, and a person who brings a block to its place."""

import numpy as np
import pytest
from grasp_setup import allegro, centred_map, person_who_plays
from pydrake.math import RigidTransform
from task_bench import judged

from geort_drake import load_scenario, run_trial
from geort_drake.simulation.free_play import keep_reached, seen_fingertips
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.tasks.pick_place.monitor import TransferMonitor, TransferOutcome
from geort_drake.systems.port_values import pose_to_vector

X_WP = RigidTransform([0.5, 0.15, 0.01])


def outcome_of(path: list[tuple[float, float, float, float]]) -> TransferOutcome:
    """The judgement of an object on lines between (y, z, yaw, force of two fingers), one a second."""
    task, rows = find_task("pick_place"), np.array(path)
    height = next(iter(task.heights.values()))
    monitor = TransferMonitor(2, X_WP, lambda X: X.translation()[2] - height / 2, 0.0)
    poses = [[np.cos(yaw / 2), 0, 0, np.sin(yaw / 2), 0.5, y, z + height / 2] for y, z, yaw, _ in path]
    t = np.arange(len(path), dtype=float)
    return judged(monitor, t[-1], object_pose=(t, poses), contact=(t, rows[:, [3, 3]]))


GRASP = [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)]
LIFT = [*GRASP, (0.0, 0.1, 0.0, 1.0)]
CARRY = [*LIFT, (0.15, 0.1, 0.0, 1.0)]


@pytest.mark.parametrize(
    ("path", "reached"),
    [
        (GRASP, 1),
        ([*GRASP, (0.15, 0.0, 0.0, 1.0), (0.15, 0.0, 0.0, 0.0), (0.15, 0.0, 0.0, 0.0)], 1),  # pushed there
        (LIFT, 2),
        (CARRY, 3),
        ([*CARRY, (0.165, 0.0, 0.0, 1.0), (0.165, 0.0, 0.0, 0.0), (0.165, 0.0, 0.0, 0.0)], 3),  # beside it
        ([*CARRY, (0.15, 0.0, 0.3, 1.0), (0.15, 0.0, 0.3, 0.0), (0.15, 0.0, 0.3, 0.0)], 3),  # turned
        ([*CARRY, (0.15, 0.0, np.pi / 2, 1.0), (0.15, 0.0, np.pi / 2, 1.0)], 4),  # as a square is, but held
        ([*CARRY, (0.15, 0.0, 0.0, 1.0), (0.15, 0.0, 0.0, 0.0), (0.15, 0.0, 0.0, 0.0)], 5),
    ],
)
def test_blocks_are_graded_by_the_steps_reached_in_order(path, reached):
    outcome = outcome_of(path)
    assert outcome.score == pytest.approx(reached / 5) and outcome.success == (reached == 5)


def test_a_left_hand_has_its_place_on_the_other_side():
    task = find_task("pick_place")
    scenario = load_scenario(*task.scenario)
    left, right = (task.place(scenario, side, np.random.default_rng(0)) for side in ("left", "right"))
    assert right.translation()[1] < -0.1 < 0.1 < left.translation()[1]
    assert pose_to_vector(left)[:4] == pytest.approx(pose_to_vector(right)[:4])


def test_a_person_brings_a_block_to_its_place():
    """Through an affine map."""
    task, person = find_task("pick_place"), person_who_plays()
    scenario = load_scenario(*task.scenario)
    retarget = centred_map()
    play = seen_fingertips(retarget, allegro(), person)
    goal, _ = keep_reached(task.plans(scenario, allegro().description), play)
    result, _ = run_trial(scenario, retarget, (person, goal))
    assert result.success, result.outcome
