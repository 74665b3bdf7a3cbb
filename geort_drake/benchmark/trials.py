"""Plans and simulates the trials of a benchmark; workers load this module, so it imports no training."""

import logging
import os
import traceback
from typing import Any, NamedTuple

from geort_drake.benchmark.log import Row, TrialKey
from geort_drake.errors import ScenarioError
from geort_drake.hands.description import load_hand
from geort_drake.own_method import OwnMethod
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.retargeting.base import Retarget
from geort_drake.simulation.scenario import Scenario, parse_scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.trial import run_trial


class Trial(NamedTuple):
    """Everything a worker needs to simulate one trial.

    Attributes:
        key: key of the trial; its object, person and seed replace those of the scenario.
        scenario_text: the scenario, as YAML, because Drake's configurations cannot be pickled.
        retarget: the method; must be picklable.
        latency: time from keypoints to joint targets, s.
        human: the simulated person's hand and goal, or a recorded session.
        attainable: whether free play showed the person an attainable plan.
    """

    key: TrialKey
    scenario_text: str
    retarget: Retarget
    latency: float
    human: tuple[HumanHand, Any] | Recording
    attainable: bool = True


def plan(scenario_text: str, case: str) -> list | str:
    """Returns the goals for a case of the scenario's task, or why the hand cannot do it."""
    scenario = _scenario(scenario_text, case)
    try:
        return find_task(scenario.task).plans(scenario, load_hand(scenario.hand))
    except ScenarioError as error:
        return str(error)


def simulate(trial: Trial, rerun_path: str | os.PathLike | None = None) -> Row:
    """Simulates a trial.

    Args:
        trial: trial to simulate.
        rerun_path: file of the Rerun recording; None for none.

    Returns:
        The fields of the key and of the task's result, `timeout`, `attainable`, and `faults` of an
        `OwnMethod`; after an exception, `error` and its `traceback` instead of a result.
    """
    key = trial.key
    try:
        scenario = _scenario(trial.scenario_text, key.object)
        scenario.random_seed, scenario.person = key.seed, key.person
        scenario.retargeting.latency = trial.latency
        result, _ = run_trial(
            scenario,
            trial.retarget,
            trial.human,
            rerun_path,
            {"method": key.method},
        )
    except Exception as error:
        return error_row(key, f"{type(error).__name__}: {error}", traceback.format_exc())
    row = {**result.to_json(), **key._asdict(), "timeout": scenario.timeout, "attainable": trial.attainable}
    if isinstance(trial.retarget, OwnMethod):
        row["faults"] = dict(trial.retarget.faults)
    return row


def error_row(key: TrialKey, error: str, trace: str = "") -> Row:
    """Returns the row of a trial that could not be simulated."""
    return {**key._asdict(), "error": error, "traceback": trace}


def _scenario(text: str, case: str) -> Scenario:
    # Drake repeats the same warnings at every step of every trial.
    logging.getLogger("drake").setLevel(logging.ERROR)
    scenario = parse_scenario(text)
    find_task(scenario.task).choose(scenario, case)
    return scenario
