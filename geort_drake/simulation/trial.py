"""Builds trials, and simulates one from start to outcome.

Before a trial, the person moves freely: they see where the robot's fingertips go, and select a plan.
"""

import dataclasses as dc
import functools
import gc
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from geort_drake.hands.hand import Hand
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.play import synthesize_play
from geort_drake.people.synthetic.population import sample_person
from geort_drake.retargeting.base import Retarget, forget
from geort_drake.retargeting.universal import UniversalRetargeter
from geort_drake.simulation.diagram import TrialDiagram, make_trial_diagram
from geort_drake.simulation.following import ROBOT_FIELDS
from geort_drake.simulation.person.goal import Goal, Intended
from geort_drake.simulation.person.perception import FreePlay
from geort_drake.simulation.scenario import Scenario, dump_scenario, parse_scenario
from geort_drake.simulation.task import Outcome, TrialResult
from geort_drake.simulation.tasks import find_task

_REPORT_PERIOD = 0.25  # simulated s
PLAY_DURATION, PLAY_RATE = 30.0, 30.0  # s, frames per second
# Seed of the people by `Scenario.person`. Universal maps are trained on the population of seed 0, and
# compared on that of seed 1000.
_POPULATION = 2000
# Fields of a scenario on which plans depend.
_PLAN_FIELDS = (*ROBOT_FIELDS, "task", "task_settings", "hand", "object")


@functools.lru_cache(maxsize=32)  # a solid hand takes seconds, for each function and method
def _frames(person: HumanHand, duration: float) -> np.ndarray:
    """Returns keypoints (T, 21, 3) of free play, m in H."""
    return synthesize_play(seed=0, duration_s=duration, rate_hz=PLAY_RATE, hand=person).p_HK.astype(float)


def seen_fingertips(
    retarget: Callable[[np.ndarray], np.ndarray], hand: Hand, person: HumanHand, latency: float = 0.0
) -> FreePlay:
    """Returns the person's and the robot's fingertips during free play; none if the method raises.

    Args:
        retarget: the method; for a universal map, the result of `after_play`.
        latency: latency of the method, s; if it exceeds the time between frames, the method gets fewer.
    """
    forget(retarget)
    frames = _frames(person, PLAY_DURATION)
    stride = max(1, math.ceil(latency * PLAY_RATE))
    frames = frames[::stride]
    order = [list(retarget.joint_names).index(name) for name in hand.joint_names]  # type: ignore[attr-defined]
    try:
        q = np.array([retarget(frame) for frame in frames])[:, order]
    except (Exception, SystemExit):  # a method may raise anything; its trials record the error
        q = np.empty((0, len(order)))
    finite = np.isfinite(q).all(axis=1)
    tips = [4 * FINGER_NAMES.index(name) + 4 for name in hand.finger_names]
    p_HF = frames[: len(q)][finite][:, tips]
    p_BF = hand.fingertips(np.clip(q[finite], hand.lower, hand.upper))
    return FreePlay(p_HF, p_BF, stride / PLAY_RATE)


def after_play(retarget: Any, person: HumanHand) -> Any:
    """Returns the map after free play: a universal map adapted to the person, any other as it is."""
    return (
        retarget.for_person(_frames(person, PLAY_DURATION))
        if isinstance(retarget, UniversalRetargeter)
        else retarget
    )


def select_reachable(plans: Sequence[Intended], play: FreePlay) -> tuple[Intended, bool]:
    """Selects the first plan whose places the robot's fingertips have all reached, within its clearance.

    A fingertip has reached a place if its smallest distance from it is within the clearance.

    Args:
        plans: at least one, in order of preference.
        play: result of `seen_fingertips`; the returned plan carries it.

    Returns:
        The plan and True; or, without an attainable plan, the nearest one with infinite clearance, and False.
    """
    excess = [_excess(play.p_BF, goal) for goal in plans]
    plan, attainable = plans[excess.index(min(excess))], min(excess) == 0.0
    return dc.replace(plan, play=play, clearance=plan.clearance if attainable else np.inf), attainable


def _excess(p_BF: np.ndarray, goal: Goal) -> float:
    """Returns the largest distance by which play (T, F, 3) missed a goal's places beyond its clearance, m."""
    if goal.clearance == np.inf:
        return 0.0
    misses = [np.linalg.norm(p_BF - place, axis=-1).min(axis=0, initial=np.inf) for place in goal.places()]
    return max(float(np.max(misses, axis=0)[goal.touches].max()) - goal.clearance, 0.0)


class Trial(NamedTuple):
    """What determines a trial: equal descriptions have equal results bit for bit, wherever they run.

    Attributes:
        scenario: what is simulated, with the method's latency and how its map begins in `retargeting`.
        retarget: the method, or its map as the trial begins.
        human: the simulated person's hand and goal, or a recording of glove and wrist to replay.
        attainable: whether free play showed the person an attainable plan.
    """

    scenario: Scenario
    retarget: Retarget
    human: tuple[HumanHand, Goal] | Recording
    attainable: bool = True

    def __reduce__(self) -> tuple:
        # Drake's configurations cannot be pickled.
        return _trial_of, (dump_scenario(self.scenario), *self[1:])


def _trial_of(scenario_text: str, *others: Any) -> Trial:
    return Trial(parse_scenario(scenario_text), *others)


class TrialBuilder:
    """Builds the trials of one robot hand, and keeps plans, people and their free play for the next ones.

    Args:
        hand: model of the robot's hand.
        recording: recording of the hand of person 0, see `Scenario.person`; by default `measured_adult`'s.
            The joints of that hand move as far as the recorded ones did, and at least as far as an adult's.
    """

    def __init__(self, hand: Hand, recording: Recording | None = None):
        self._hand = hand
        self._plans: dict[str, Sequence[Goal]] = {}
        adult = HumanHand.measured_adult()
        first = HumanHand.fit(recording).with_range_of(adult) if recording else adult
        self._people: dict[int, HumanHand] = {0: first}
        # The maps by whose identity a practice is found are kept with it.
        self._practice: dict[tuple, tuple[Retarget, Retarget, FreePlay]] = {}

    def plans(self, scenario: Scenario) -> Sequence[Goal]:
        """Returns the goals with which a person may do the scenario's task, best first.

        Raises:
            ScenarioError: the robot cannot do it.
        """
        key = plan_key(scenario)
        if key not in self._plans:
            self._plans[key] = find_task(scenario.task).plans(scenario, self._hand.description)
        return self._plans[key]

    def keep_plans(self, scenario: Scenario, goals: Sequence[Goal]) -> None:
        """Adds plans that another process has made."""
        self._plans[plan_key(scenario)] = goals

    def person(self, number: int) -> HumanHand:
        """Returns the hand of a person of the population by `Scenario.person`."""
        if number not in self._people:
            self._people[number] = sample_person(_POPULATION, number).hand.in_wrist_frame()
        return self._people[number]

    def trial(self, scenario: Scenario, retarget: Retarget) -> Trial:
        """Returns the trial of a person who selects a plan by what they saw of a method in free play.

        A universal map adapts to the person in free play. The trial begins with that fixed map, or with the
        map before if the scenario says so.

        Raises:
            ScenarioError: the robot cannot do the task.
        """
        plans, person, timing = self.plans(scenario), self.person(scenario.person), scenario.retargeting
        key = id(retarget), scenario.person, timing.latency
        if key not in self._practice:
            adapted_map = after_play(retarget, person)
            fingertips = seen_fingertips(adapted_map, self._hand, person, timing.latency)
            self._practice[key] = retarget, adapted_map, fingertips
        _, adapted_map, fingertips = self._practice[key]
        goal, attainable = select_reachable(plans, fingertips)
        return Trial(scenario, adapted_map if timing.adapts_before else retarget, (person, goal), attainable)


def plan_key(scenario: Scenario) -> str:
    """Returns a text that two scenarios share if they have the same plans."""
    return dump_scenario(Scenario(**{name: getattr(scenario, name) for name in _PLAN_FIELDS}))


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
            "task": result.task,
            "object": result.object,
            "seed": scenario.random_seed,
            "outcome": result.outcome,
        }
        if parts.recorder is not None:
            from geort_drake.simulation.recording import describe_result

            describe_result(parts.recorder, scenario, properties, result)
        return result, parts.glove_recorder.recording(metadata)
    finally:
        if parts.recorder is not None:
            parts.recorder.close()


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
