"""What a worker of the grasp benchmark does: plan a grasp, or simulate one trial; nothing else is loaded."""

import logging
import os
import traceback

from geort_drake.benchmark.trial_log import TrialKey, identity
from geort_drake.hands.description import load_hand
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.recording import Recording
from geort_drake.simulation.diagram import Retarget
from geort_drake.simulation.scenario import Scenario, parse_scenario
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner
from geort_drake.simulation.trial import run_trial


def plan(scenario_text: str, object_name: str) -> GraspGoal:
    """The planned grasp of an object in a resolved scenario."""
    scenario = _scenario(scenario_text, object_name)
    return GraspPlanner(scenario, load_hand(scenario.hand)).plan()


def simulate(
    key: TrialKey,
    scenario_text: str,
    retarget: Retarget,
    latency: float,
    human: tuple[HumanHand, GraspGoal] | Recording,
    rerun_path: str | os.PathLike | None = None,
) -> dict:
    """One trial, as its line in the results: the fields of `TrialResult`, `method` and `condition`.

    Whatever a trial raises becomes the text of its traceback under `error`, in place of a result.
    """
    try:
        scenario = _scenario(scenario_text, key.object)
        scenario.random_seed = key.seed
        scenario.retargeting.latency = latency
        properties = {"method": key.method}
        result, _ = run_trial(scenario, retarget, human, rerun_path, properties)
    except Exception:
        return {**identity(key), "error": traceback.format_exc()}
    return {**identity(key), **result.to_json()}


def _scenario(text: str, object_name: str) -> Scenario:
    # Drake warns of the same things at every step of every trial.
    logging.getLogger("drake").setLevel(logging.ERROR)
    scenario = parse_scenario(text)
    scenario.object.name = object_name
    return scenario
