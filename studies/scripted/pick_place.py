"""The scripted robot of pick and place."""

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.person.goal import GraspGoal
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks import find_task, pick_place
from geort_drake.simulation.trial import run_trial
from scripted.oracle import HOLDING, object_pose, oracle, script

SQUEEZE = 0.012  # m, depth of the squeeze


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
    squeeze, timeout = SQUEEZE, scenario.timeout
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
