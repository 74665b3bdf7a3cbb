"""Runs one grasp trial from start to outcome."""

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
from geort_drake.systems.release import release

_REPORT_PERIOD = 0.25  # simulated s


@dc.dataclass(frozen=True)
class TrialResult:
    """Result of one trial; times in simulated s."""

    object: str
    seed: int
    success: bool
    # "success"; "timeout: PHASE" with the monitor's last phase; or "thrown: PHASE" with the last phase in
    # which a finger touched the object, or reach if none did, as when the palm knocked it over.
    outcome: str
    # Whether it succeeded and only links of fingertips touched the object during the hold.
    tip_success: bool
    # Time in which each link of the hand touched the object during the hold.
    holding: dict[str, float]
    # The simulated operator's last phase, for example approach or close; None in a replay.
    operator_phase: str | None
    # Time from the start to the beginning of the hold; None without success.
    completion_time: float | None
    # Whether the first attempt succeeded, and the number of attempts; None in a replay.
    first_attempt: bool | None
    attempts: int | None
    simulated_time: float
    # By phase of the monitor: first entry, and total time.
    phase_times: dict[str, float]
    phase_durations: dict[str, float]
    # Number of lifts that ended in a drop, see `GraspOutcome`.
    drops: int
    # Largest displacement of the object in the hand during the last lift, m; None without a lift.
    slip: float | None
    # Fraction of the time in which two links of the hand touched each other, see `SceneView`.
    self_contact: float
    peak_force: float
    peak_height: float
    wall_time: float

    def to_json(self) -> dict:
        """Returns plain JSON types."""
        return dc.asdict(self)


def run_trial(
    scenario: Scenario,
    retarget: Retarget,
    human: tuple[HumanHand, GraspGoal] | Recording,
    rerun_path: str | os.PathLike | None = None,
    properties: Mapping[str, str | int | float | bool] | None = None,
    report: Callable[[float], None] | None = None,
) -> tuple[TrialResult, Recording]:
    """Simulates one grasp trial until it succeeds, fails or times out.

    Args:
        scenario, retarget, human, rerun_path, properties: as for `make_grasp_diagram`.
        report: called with the simulated time, s, every 0.25 simulated s.

    Returns:
        The result, and the glove and tracker data of the trial for `GloveReplay`.
    """
    started = time.perf_counter()
    # Methods with a memory forget the previous trial.
    if callable(reset := getattr(retarget, "reset", None)):
        reset()
    properties = {**(properties or {}), "seed": scenario.random_seed}
    parts = make_grasp_diagram(scenario, retarget, human, rerun_path, properties)
    simulator = Simulator(parts.diagram)
    root = simulator.get_mutable_context()
    parts.initialize(root)
    context = parts.monitor.GetMyContextFromRoot(root)
    try:
        # The monitor terminates the simulation when the grasp is judged.
        while not (outcome := parts.monitor.outcome(context)).over and root.get_time() < scenario.timeout:
            if report is not None:
                report(root.get_time())
            simulator.AdvanceTo(min(root.get_time() + _REPORT_PERIOD, scenario.timeout))
        result = _result(scenario, parts, outcome, root, time.perf_counter() - started)
        metadata = {
            "side": parts.description.side,
            "source": "simulated trial",
            "object": scenario.object.name,
            "seed": scenario.random_seed,
            "outcome": result.outcome,
        }
        if parts.recorder is not None:
            parts.recorder.set_properties({"outcome": result.outcome})
        return result, parts.glove_recorder.recording(metadata)
    finally:
        if parts.recorder is not None:
            parts.recorder.close()
        release(parts.diagram)


def _result(
    scenario: Scenario, parts: GraspDiagram, outcome: GraspOutcome, root: Context, wall_time: float
) -> TrialResult:
    attempts = operator_phase = None
    if parts.operator is not None:
        memory = parts.operator.memory(parts.operator.GetMyContextFromRoot(root))
        attempts, operator_phase = memory.attempt, memory.phase.name.lower()
    if outcome.success:
        text = "success"
    elif outcome.phase == GraspPhase.THROWN:
        text = f"thrown: {outcome.last_touched.name.lower()}"
    else:
        text = f"timeout: {outcome.phase.name.lower()}"
    simulated_time = root.get_time()
    tip_links = {finger.tip_link for finger in parts.description.fingers}
    return TrialResult(
        object=scenario.object.name,
        seed=scenario.random_seed,
        success=outcome.success,
        outcome=text,
        tip_success=outcome.success and outcome.holding.keys() <= tip_links,
        holding={link: round(spent, 6) for link, spent in outcome.holding.items()},
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
