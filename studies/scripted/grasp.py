"""The scripted robot of the grasp."""

from geort_drake.simulation.person.goal import GraspGoal
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.trial import run_trial
from scripted.oracle import oracle, script
from scripted.pick_place import plans

__all__ = ["plans", "scripted"]

SQUEEZE = 0.02  # m, depth of the squeeze


def scripted(scenario: Scenario, goal: GraspGoal, seed: int) -> float:
    """Returns the score of a robot that knows the object and carries out the plan; 0 without success."""
    scenario.random_seed = seed
    robot = oracle(scenario.hand)
    motion = script(scenario, robot, goal, SQUEEZE)
    scenario.timeout = float(motion.t[-1])
    result, _ = run_trial(scenario, robot, motion)
    return result.score if result.success else 0.0
