"""One grasp trial from start to outcome."""

import dataclasses as dc
import math
import os
import time
from collections.abc import Callable, Mapping

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from geort_drake.people.human_hand import HumanHand
from geort_drake.people.recording import Recording
from geort_drake.simulation.diagram import GraspDiagram, Retarget, make_grasp_diagram
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.monitor import GraspOutcome, GraspPhase

_REPORT_PERIOD = 0.25  # simulated s


@dc.dataclass(frozen=True)
class TrialResult:
    """What came of one trial; times in simulated s."""

    object: str
    seed: int
    success: bool
    # "success"; or "timeout: PHASE" with the monitor's phase at the end; or "thrown: PHASE" with the last one
    # before the throw in which a finger touched the object: touch, grasp, lift or hold, or reach where none
    # ever did, as when the palm knocked it over.
    outcome: str
    # What the simulated operator was doing at the end, which tells an object thrown while approaching from
    # one thrown while closing; None in a replay.
    operator_phase: str | None
    # Start to the beginning of the hold; None without success.
    completion_time: float | None
    # Whether the first closing succeeded; None in a replay, where nobody decides.
    first_attempt: bool | None
    attempts: int | None
    simulated_time: float
    # First entry of each phase of the monitor, and the time spent in it.
    phase_times: dict[str, float]
    phase_durations: dict[str, float]
    # How often a lifted object fell back to its support or was let go of, see `GraspMonitor`.
    drops: int
    # Furthest way of the object in the hand during the last lift, m; None where nothing was lifted.
    slip: float | None
    # Share of the time for which two links of the hand touched each other, fingertip on fingertip not
    # counted: looked at whenever the monitor looks, in the plant's contact results (see `SceneView`).
    self_contact: float
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
    attempts = operator_phase = None
    if parts.operator is not None:
        context = parts.operator.GetMyContextFromRoot(root)
        attempts = parts.operator.attempt(context)
        operator_phase = parts.operator.phase(context).name.lower()
    simulated_time = root.get_time()
    if outcome.success:
        text = "success"
    elif outcome.phase == GraspPhase.THROWN:
        text = f"thrown: {outcome.last_touched.name.lower()}"
    else:
        text = f"timeout: {outcome.phase.name.lower()}"
    return TrialResult(
        object=scenario.object.name,
        seed=scenario.random_seed,
        success=outcome.success,
        outcome=text,
        operator_phase=operator_phase,
        completion_time=outcome.completion_time if outcome.success else None,
        first_attempt=None if attempts is None else outcome.success and attempts == 1,
        attempts=attempts,
        simulated_time=simulated_time,
        phase_times=outcome.times,
        phase_durations={name: round(spent, 6) for name, spent in outcome.durations.items()},
        drops=outcome.drops,
        slip=None if math.isnan(outcome.slip) else outcome.slip,
        self_contact=outcome.self_contact_time / simulated_time if simulated_time else 0.0,
        peak_force=outcome.peak_force,
        peak_height=outcome.peak_height,
        wall_time=wall_time,
    )
