"""One grasp trial from start to outcome."""

import dataclasses as dc
import math
import os
import time
from collections.abc import Callable, Mapping

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from geort_drake.gloves.human_hand import HumanHand
from geort_drake.gloves.recording import Recording
from geort_drake.operators.grasp_goal import GraspGoal
from geort_drake.simulation.diagram import GraspDiagram, Retarget, make_grasp_diagram
from geort_drake.simulation.scenario import Scenario
from geort_drake.systems.grasp_monitor import GraspOutcome, GraspPhase

_REPORT_PERIOD = 0.25  # simulated s


@dc.dataclass(frozen=True)
class TrialResult:
    """What came of one trial; times in simulated s."""

    object: str
    seed: int
    success: bool
    # "success", or "thrown: PHASE" or "timeout: PHASE" with the phase it failed in.
    outcome: str
    # Start to the beginning of the hold; None without success.
    completion_time: float | None
    # Whether the first closing succeeded; None in a replay, where nobody decides.
    first_attempt: bool | None
    attempts: int | None
    simulated_time: float
    # First entry of each phase of the monitor, and the time spent in it.
    phase_times: dict[str, float]
    phase_durations: dict[str, float]
    drops: int
    # Furthest way of the object in the hand during the last lift, m; None where nothing was lifted.
    slip: float | None
    peak_force: float
    peak_height: float
    wall_time: float

    def to_json(self) -> dict:
        """Plain JSON types."""
        return dc.asdict(self)


def run_trial(
    scenario: Scenario,
    retarget: Retarget,
    human: tuple[HumanHand, GraspGoal] | Recording,
    rerun_path: str | os.PathLike | None = None,
    properties: Mapping[str, str | int | float | bool] | None = None,
    report: Callable[[float], None] | None = None,
) -> tuple[TrialResult, Recording]:
    """Simulates until the grasp is judged or the time is up.

    Args:
        scenario, retarget, human, rerun_path, properties: as for `make_grasp_diagram`.
        report: called with the simulated time now and then, for a progress display.

    Returns:
        The result, and the glove and tracker data of the trial, which `GloveReplay` can play again.
    """
    started = time.perf_counter()
    # Methods that continue from their last answer begin each trial afresh.
    if callable(reset := getattr(retarget, "reset", None)):
        reset()
    parts = make_grasp_diagram(
        scenario, retarget, human, rerun_path, {**(properties or {}), "seed": scenario.random_seed}
    )
    simulator = Simulator(parts.diagram)
    root = simulator.get_mutable_context()
    parts.initialize(root)
    context = parts.monitor.GetMyContextFromRoot(root)
    try:
        # The monitor ends it when the grasp is judged.
        while not (outcome := parts.monitor.outcome(context)).over and root.get_time() < scenario.timeout:
            if report is not None:
                report(root.get_time())
            simulator.AdvanceTo(min(root.get_time() + _REPORT_PERIOD, scenario.timeout))
        result = _result(scenario, parts, outcome, root, time.perf_counter() - started)
        if parts.recorder is not None:
            parts.recorder.set_properties({"outcome": result.outcome})
    finally:
        if parts.recorder is not None:
            parts.recorder.close()
    recording = parts.glove_recorder.recording(
        {
            "side": parts.description.side,
            "source": "simulated trial",
            "object": scenario.object.name,
            "seed": scenario.random_seed,
            "outcome": result.outcome,
        }
    )
    return result, recording


def _result(
    scenario: Scenario, parts: GraspDiagram, outcome: GraspOutcome, root: Context, wall_time: float
) -> TrialResult:
    attempts = None
    if parts.operator is not None:
        attempts = parts.operator.attempt(parts.operator.GetMyContextFromRoot(root))
    if outcome.success:
        text = "success"
    elif outcome.phase == GraspPhase.THROWN:
        text = f"thrown: {_phase_before_throw(outcome)}"
    else:
        text = f"timeout: {outcome.phase.name.lower()}"
    return TrialResult(
        object=scenario.object.name,
        seed=scenario.random_seed,
        success=outcome.success,
        outcome=text,
        completion_time=outcome.completion_time if outcome.success else None,
        first_attempt=None if attempts is None else outcome.success and attempts == 1,
        attempts=attempts,
        simulated_time=root.get_time(),
        phase_times=outcome.times,
        phase_durations={name: round(spent, 6) for name, spent in outcome.durations.items()},
        drops=outcome.drops,
        slip=None if math.isnan(outcome.slip) else outcome.slip,
        peak_force=outcome.peak_force,
        peak_height=outcome.peak_height,
        wall_time=wall_time,
    )


def _phase_before_throw(outcome: GraspOutcome) -> str:
    """The furthest phase reached before the object was lost."""
    reached = [GraspPhase[name] for name in outcome.times if name != GraspPhase.THROWN.name]
    return max(reached).name.lower()
