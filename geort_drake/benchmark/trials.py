"""Plans and simulates the trials of a benchmark; workers load this module, so it imports no training."""

import logging
import traceback
from collections.abc import Sequence

from geort_drake.benchmark.log import Row, TrialKey
from geort_drake.errors import ScenarioError
from geort_drake.hands.description import load_hand
from geort_drake.own_method import OwnMethod
from geort_drake.simulation.person.goal import Goal
from geort_drake.simulation.scenario import parse_scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.trial import Trial, run_trial


def plan(scenario_text: str) -> Sequence[Goal] | str:
    """Returns the goals for a scenario, or why the robot cannot do its task."""
    _quieten_drake()
    scenario = parse_scenario(scenario_text)
    try:
        return find_task(scenario.task).plans(scenario, load_hand(scenario.hand))
    except ScenarioError as error:
        return str(error)


def simulate(key: TrialKey, trial: Trial) -> Row:
    """Simulates a trial.

    Returns:
        The fields of the key and of the task's result, `timeout`, `attainable`, and `faults` of an
        `OwnMethod`; after an exception, `error` and its `traceback` instead of a result.
    """
    _quieten_drake()
    try:
        result, _ = run_trial(trial.scenario, trial.retarget, trial.human)
    except Exception as error:
        return error_row(key, f"{type(error).__name__}: {error}", traceback.format_exc())
    timeout = trial.scenario.timeout
    row = {**result.to_json(), **key._asdict(), "timeout": timeout, "attainable": trial.attainable}
    if isinstance(trial.retarget, OwnMethod):
        row["faults"] = dict(trial.retarget.faults)
    return row


def error_row(key: TrialKey, error: str, trace: str = "") -> Row:
    """Returns the row of a trial that could not be simulated."""
    return {**key._asdict(), "error": error, "traceback": trace}


def _quieten_drake() -> None:
    # Drake repeats the same warnings at every step of every trial.
    logging.getLogger("drake").setLevel(logging.ERROR)
