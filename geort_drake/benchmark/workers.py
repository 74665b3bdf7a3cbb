"""Plans and simulates trials in worker processes.

Workers load this module, so it imports no training.
"""

import logging
import os
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from typing import Any

from joblib import Parallel, delayed, parallel_config

from geort_drake.benchmark.log import Row, TrialKey
from geort_drake.errors import BenchmarkError, ScenarioError
from geort_drake.hands.description import load_hand
from geort_drake.own_method import OwnMethod
from geort_drake.processes import end_with
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


def call_in_workers(
    function: Callable, arguments: Iterable[tuple], jobs: int, ordered: bool = False
) -> Iterator[Any]:
    """Calls `function` with each of `arguments` in workers, and yields the results.

    Args:
        function: function to call; must be picklable.
        arguments: arguments of each call.
        jobs: number of simultaneous calls; a single one runs in this process.
        ordered: whether to yield results in the order of the arguments; otherwise as they are ready.

    Raises:
        BenchmarkError: a worker ended before its call did.
    """
    starting: dict[str, Any] = {"initializer": end_with, "initargs": (os.getpid(),)}
    with parallel_config(backend="loky", inner_max_num_threads=1, **starting):
        # Calls are long and their arguments small: dispatch singly, without memory-mapped files.
        order = "generator" if ordered else "generator_unordered"
        parallel = Parallel(jobs, return_as=order, batch_size=1, max_nbytes=None)
    try:
        yield from parallel(delayed(function)(*each) for each in arguments)
    except BrokenExecutor as error:
        raise BenchmarkError(
            "a worker process ended, perhaps because memory ran out; finished trials are kept: run the same "
            "command again, with fewer --jobs if needed"
        ) from error
