"""Simulates one trial from start to outcome."""

import gc
import os
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from geort_drake.files import atomic_path
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.retargeting.base import Retarget, forget
from geort_drake.simulation.diagram import TrialDiagram, make_trial_diagram
from geort_drake.simulation.judge import Outcome
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import TrialResult
from geort_drake.simulation.tasks import find_task

if TYPE_CHECKING:
    from geort_drake.rerun import RerunRecorder

_REPORT_PERIOD = 0.25  # simulated s


def run_trial(
    scenario: Scenario,
    retarget: Retarget,
    human: tuple[HumanHand, Any] | Recording,
    rerun_path: str | os.PathLike | None = None,
    properties: Mapping[str, str | int | float | bool] | None = None,
    report: Callable[[float], None] | None = None,
) -> tuple[TrialResult, Recording]:
    """Simulates one trial until it succeeds, fails or times out.

    Args:
        scenario, retarget, human, rerun_path, properties: see `make_trial_diagram`.
        report: called with the simulated time, s, every 0.25 s of it.

    Returns:
        The result, and the glove and tracker data of the trial for `GloveReplay`.
    """
    started = time.perf_counter()
    gc.collect()  # the previous trial's diagram, which is part of reference cycles
    forget(retarget)
    properties = {**(properties or {}), "seed": scenario.random_seed}
    parts = make_trial_diagram(scenario, retarget, human, rerun_path, properties)
    simulator = Simulator(parts.diagram)
    root = simulator.get_mutable_context()
    parts.initialize(root)
    try:
        # The judge ends the simulation when the task is decided.
        while not (outcome := parts.stage.outcome(root)).over and root.get_time() < scenario.timeout:
            if report is not None:
                report(root.get_time())
            simulator.AdvanceTo(min(root.get_time() + _REPORT_PERIOD, scenario.timeout))
        result = _result(scenario, parts, outcome, root, time.perf_counter() - started)
        metadata = {
            "side": parts.description.side,
            "source": "simulated trial",
            "object": result.object,
            "seed": scenario.random_seed,
            "outcome": result.outcome,
        }
        if parts.recorder is not None:
            _describe(parts.recorder, scenario, properties, result)
        return result, parts.glove_recorder.recording(metadata)
    finally:
        if parts.recorder is not None:
            parts.recorder.close()


def _describe(
    recorder: "RerunRecorder", scenario: Scenario, properties: Mapping[str, object], result: TrialResult
) -> None:
    """Adds the outcome to a trial's recording, and writes its samples as a table for exports."""
    import pyarrow.parquet as pq

    from geort_drake.simulation.recording import trial_text

    when = result.completion_time if result.success else result.simulated_time
    outcome = f"{result.outcome}, {when:.1f} s after the start"
    method = f", {properties['method']}" if "method" in properties else ""
    recorder.set_properties({"outcome": result.outcome})
    recorder.describe(
        f"{result.object} {scenario.random_seed}{method}: {result.outcome}",
        trial_text(scenario, properties, outcome),
    )
    if recorder.path is not None:
        with atomic_path(recorder.path.with_suffix(".parquet")) as draft:
            pq.write_table(recorder.table(), draft)


def _result(
    scenario: Scenario, parts: TrialDiagram, outcome: Outcome, root: Context, wall_time: float
) -> TrialResult:
    task = find_task(scenario.task)
    attempts = operator_phase = None
    if parts.operator is not None:
        memory = parts.operator.memory(parts.operator.GetMyContextFromRoot(root))
        attempts, operator_phase = memory.attempt, parts.operator.phases[memory.phase]
    simulated_time = root.get_time()
    return TrialResult(
        task=task.name,
        object=task.case_of(scenario),
        seed=scenario.random_seed,
        success=outcome.success,
        score=outcome.score,
        outcome=outcome.text,
        operator_phase=operator_phase,
        completion_time=outcome.completion_time if outcome.success else None,
        first_attempt=None if attempts is None else outcome.success and attempts == 1,
        attempts=attempts,
        simulated_time=simulated_time,
        self_contact=outcome.self_contact_time / simulated_time if simulated_time else 0.0,
        peak_force=outcome.peak_force,
        wall_time=wall_time,
        metrics=outcome.metrics,
    )
