"""Trials of a benchmark: planning, simulation in workers, and the results file.

Workers load this module, so it imports neither training nor plots.
"""

import logging
import os
import traceback
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from geort_drake.benchmark.own_method import OwnMethod
from geort_drake.benchmark.records import Record, TrialKey, TrialLog, identity, keep_error
from geort_drake.benchmark.workers import call_in_workers
from geort_drake.errors import ScenarioError
from geort_drake.hands.description import load_hand
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.recording import Recording
from geort_drake.simulation.diagram import Retarget
from geort_drake.simulation.scenario import Scenario, parse_scenario
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner
from geort_drake.simulation.trial import run_trial


class Trial(NamedTuple):
    """Everything a worker needs to simulate one trial.

    Attributes:
        key: of the trial; its object and seed replace those of the scenario.
        scenario_text: the resolved scenario, as YAML.
        retarget: can be sent to another process.
        latency: from keypoints to joint targets, s.
        human: hand and planned grasp of the simulated person, or a recorded session.
        attainable: whether free play showed the person an attainable plan.
    """

    key: TrialKey
    scenario_text: str
    retarget: Retarget
    latency: float
    human: tuple[HumanHand, GraspGoal] | Recording
    attainable: bool = True


def run_trials(log: TrialLog, trials: Iterable[Trial], jobs: int, backend: str) -> Iterator[Record]:
    """Simulates trials in workers; logs and yields each record as its trial ends.

    Args:
        log: results file in the benchmark's folder.
        trials: to simulate.
        jobs, backend: see `call_in_workers`.

    Raises:
        BenchmarkError, GeortError: see `call_in_workers`; finished trials are kept.
    """
    for record in call_in_workers(simulate, ((trial,) for trial in trials), jobs, backend):
        kept = keep_error(log.path.parent, record)
        log.append(kept)
        yield kept


def plan_grasps(
    scenario_text: str, objects: Sequence[str], jobs: int, backend: str
) -> Iterator[tuple[str, list[GraspGoal] | str]]:
    """Plans grasps of each object in workers; yields name and result of `plan` in the objects' order."""
    arguments = ((scenario_text, name) for name in objects)
    yield from zip(objects, call_in_workers(plan, arguments, jobs, backend, ordered=True), strict=True)


def plan(scenario_text: str, object_name: str) -> list[GraspGoal] | str:
    """The planned grasps of an object in a resolved scenario, or why the hand cannot grasp it."""
    scenario = _scenario(scenario_text, object_name)
    try:
        return GraspPlanner(scenario, load_hand(scenario.hand)).plans()
    except ScenarioError as error:
        return str(error)


def simulate(trial: Trial, rerun_path: str | os.PathLike | None = None) -> Record:
    """Simulates a trial.

    Args:
        trial: to simulate.
        rerun_path: file of the Rerun recording; None for none.

    Returns:
        The fields of `TrialResult`, `method`, `condition`, `attainable` and, of an `OwnMethod`, its `faults`;
        after an exception, `error` with its traceback instead of a result.
    """
    key = trial.key
    try:
        scenario = _scenario(trial.scenario_text, key.object)
        scenario.random_seed = key.seed
        scenario.retargeting.latency = trial.latency
        result, _ = run_trial(scenario, trial.retarget, trial.human, rerun_path, {"method": key.method})
    except Exception:
        return {**identity(key), "error": traceback.format_exc()}
    record = {**identity(key), **result.to_json(), "attainable": trial.attainable}
    if isinstance(trial.retarget, OwnMethod):
        record["faults"] = dict(trial.retarget.faults)
    return record


def _scenario(text: str, object_name: str) -> Scenario:
    # Drake repeats the same warnings at every step of every trial.
    logging.getLogger("drake").setLevel(logging.ERROR)
    scenario = parse_scenario(text)
    scenario.object.name = object_name
    return scenario
