"""The scripted robot of pick and place."""

import functools

import numpy as np
from plans import DAMPING, HOLDING, LARGEST_STEP, Oracle, object_pose, script
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.hands.description import HandDescription
from geort_drake.hands.hand import Hand
from geort_drake.simulation.operators.goal import GraspGoal
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks import find_task, pick_place
from geort_drake.simulation.trial import run_trial

PULL = 0.1  # fraction of the distance to the middle of the joint ranges per iteration


def plans(scenario: Scenario, description: HandDescription) -> list[GraspGoal]:
    """Returns the task's own plans; inverse kinematics finds the joint positions."""
    return find_task(scenario.task).plans(scenario, description)


def scripted(scenario: Scenario, goal: GraspGoal, seed: int) -> float:
    """Returns the score of a robot that knows object and place and carries out the plan; 0 without success.

    A first run ends with the lift and gives the object's orientation in the hand.
    """
    transfer, robot = pick_place.TRANSFER, oracle(scenario.hand)
    scenario.random_seed = seed
    rng = np.random.default_rng(seed).spawn(1)[0]
    X_WP = transfer.place(scenario, robot.description.side, rng)
    squeeze, timeout = scenario.operator.squeeze, scenario.timeout
    lift = script(scenario, robot, goal, squeeze)
    scenario.timeout = float(lift.t[-1]) - HOLDING
    lifted, _ = run_trial(scenario, robot, lift)
    R_WO = goal.object_frame(object_pose(scenario)).rotation()
    X_WP = RigidTransform(
        RotationMatrix.MakeZRotation(-lifted.metrics["place_turn"]) @ R_WO, X_WP.translation()
    )
    scenario.timeout = timeout
    result, _ = run_trial(scenario, robot, script(scenario, robot, goal, squeeze, (X_WP, transfer.hover)))
    return result.score if result.success else 0.0


class _RelaxedOracle(Oracle):
    """An oracle whose redundant fingers prefer the middle of their joint ranges.

    Without this, they drift while they squeeze, and open along another path than they closed.
    """

    def _solve(self, q: np.ndarray, targets: np.ndarray, iterations: int) -> np.ndarray:
        n = len(q)
        for _ in range(iterations):
            tips, J = self._hand.fingertips_and_jacobians(q[None])
            J = J.reshape(-1, n)
            inverse = J.T @ np.linalg.inv(J @ J.T + DAMPING**2 * np.eye(len(J)))
            step = inverse @ (targets - tips[0]).ravel()
            step += PULL * (np.eye(n) - inverse @ J) @ (self._start - q)
            q = np.clip(q + np.clip(step, -LARGEST_STEP, LARGEST_STEP), self._hand.lower, self._hand.upper)
        return q


@functools.cache
def oracle(hand: str) -> Oracle:
    """Returns the oracle of a robot hand."""
    return _RelaxedOracle(Hand(hand))
