"""The scripted robot of the tasks that bring an object to its place."""

import functools

import numpy as np
from plans import HOLDING, Oracle, script

from geort_drake.hands.description import HandDescription, load_hand
from geort_drake.hands.model import HandModel
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.pick_place.task import TransferTask
from geort_drake.simulation.trial import run_trial


def plans(scenario: Scenario, description: HandDescription) -> list[GraspGoal]:
    """The task's own, whose joint positions inverse kinematics finds."""
    return find_task(scenario.task).plans(scenario, description)


def scripted(scenario: Scenario, goal: GraspGoal, seed: int) -> float:
    """Score of a robot that knows where object and place are, and carries out the plan; 0 without success.

    A first run ends with the lift and tells how the object then lies in the hand.
    """
    task, oracle = find_task(scenario.task), _oracle(scenario.hand)
    assert isinstance(task, TransferTask)
    scenario.random_seed = seed
    rng = np.random.default_rng(seed).spawn(1)[0]
    X_WP = task.place(scenario, oracle.description.side, rng)
    squeeze, timeout = scenario.operator.squeeze, scenario.timeout
    lift = script(scenario, oracle, goal, squeeze)
    scenario.timeout = float(lift.t[-1]) - HOLDING
    lifted, _ = run_trial(scenario, oracle, lift)
    place = X_WP.translation(), -lifted.place_turn, task.hover
    scenario.timeout = timeout
    result, _ = run_trial(scenario, oracle, script(scenario, oracle, goal, squeeze, place))
    return result.score if result.success else 0.0


@functools.cache
def _oracle(hand: str) -> Oracle:
    return Oracle(HandModel(load_hand(hand)))
