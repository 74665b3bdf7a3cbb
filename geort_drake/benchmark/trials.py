"""Plans and simulates a benchmark's trials in workers, and logs their results.

Workers load this module, so it imports neither training nor plots.
"""

import dataclasses as dc
import logging
import os
import traceback
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from geort_drake.benchmark.own_method import OwnMethod
from geort_drake.benchmark.records import Record, TrialKey, TrialLog, identity, keep_error
from geort_drake.benchmark.workers import call_in_workers
from geort_drake.errors import ScenarioError
from geort_drake.hands.description import load_hand
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.recording import Recording
from geort_drake.retargeting.method import Retarget
from geort_drake.simulation.following import RobotModel
from geort_drake.simulation.scenario import Scenario, parse_scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.trial import run_trial


class Trial(NamedTuple):
    """Everything a worker needs to simulate one trial.

    Attributes:
        key: key of the trial; its object and seed replace those of the scenario.
        scenario_text: the resolved scenario, as YAML.
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


def run_trials(log: TrialLog, trials: Iterable[Trial], jobs: int, backend: str) -> Iterator[Record]:
    """Simulates trials in workers; logs and yields each record as its trial ends.

    Args:
        log: results file in the benchmark's folder.
        trials: trials to simulate.
        jobs, backend: see `call_in_workers`.

    Raises:
        BenchmarkError, GeortError: see `call_in_workers`; finished trials are kept.
    """
    for record in call_in_workers(simulate, ((trial,) for trial in trials), jobs, backend):
        kept = keep_error(log.path.parent, record)
        log.append(kept)
        yield kept


def plan_cases(
    scenario_text: str, cases: Sequence[str], jobs: int, backend: str
) -> Iterator[tuple[str, list | str]]:
    """Plans cases of a task in workers; yields each name and its result of `plan`, in order."""
    arguments = ((scenario_text, name) for name in cases)
    yield from zip(cases, call_in_workers(plan, arguments, jobs, backend, ordered=True), strict=True)


def plan(scenario_text: str, case: str) -> list | str:
    """Returns the goals for a case of the scenario's task, or why the hand cannot do it."""
    scenario = _scenario(scenario_text, case)
    try:
        return find_task(scenario.task).plans(scenario, load_hand(scenario.hand))
    except ScenarioError as error:
        return str(error)


def simulate(trial: Trial, rerun_path: str | os.PathLike | None = None) -> Record:
    """Simulates a trial.

    Args:
        trial: trial to simulate.
        rerun_path: file of the Rerun recording; None for none.

    Returns:
        `method`, `condition`, the fields of the task's result, `attainable`, and `faults` of an
        `OwnMethod`; after an exception, `error` with its traceback instead of a result.
    """
    key = trial.key
    try:
        scenario = _scenario(trial.scenario_text, key.object)
        scenario.random_seed = key.seed
        scenario.retargeting.latency = trial.latency
        result, _ = run_trial(
            scenario,
            trial.retarget,
            trial.human,
            rerun_path,
            {"method": key.method},
            model=_robot_model(scenario),
        )
    except Exception:
        return {**identity(key), "error": traceback.format_exc()}
    record = {**identity(key), **result.to_json(), "attainable": trial.attainable}
    if isinstance(trial.retarget, OwnMethod):
        record["faults"] = dict(trial.retarget.faults)
    return record


# Fields of a scenario that determine its robot; and the robot of this worker's last trial.
_ROBOT_FIELDS = "plant_config", "directives", "hand_parent", "arm_posture", "left_arm_posture"
_last: dict[str, RobotModel] = {}


def _robot_model(scenario: Scenario) -> RobotModel:
    """Returns the last trial's model if the robot is the same."""
    robot = Scenario(**{name: getattr(scenario, name) for name in _ROBOT_FIELDS})
    robot.retargeting = dc.replace(scenario.retargeting, latency=0.0)  # each method has its own
    description = load_hand(scenario.hand)
    key = repr((robot, description))
    if key not in _last:
        _last.clear()
        _last[key] = RobotModel(robot, description)
    return _last[key]


def _scenario(text: str, case: str) -> Scenario:
    # Drake repeats the same warnings at every step of every trial.
    logging.getLogger("drake").setLevel(logging.ERROR)
    scenario = parse_scenario(text)
    find_task(scenario.task).choose(scenario, case)
    return scenario
