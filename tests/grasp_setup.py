"""People and known maps, with which grasps and other tasks are tested without training anything."""

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from shared import shared, synthesized

from geort_drake import Hand, Recording, load_scenario, run_trial
from geort_drake.hands.description import HandDescription
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.retargeting import METHODS
from geort_drake.retargeting.affine_ik import AffineIK
from geort_drake.retargeting.base import kinematics_of
from geort_drake.simulation.diagram import TrialDiagram
from geort_drake.simulation.person.finger_motion import FingerMotion
from geort_drake.simulation.person.goal import GraspGoal
from geort_drake.simulation.person.perception import FreePlay
from geort_drake.simulation.plan.grasp import GraspPlanner
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import PERIOD, Judgement, Outcome, Stage, TrialResult
from geort_drake.simulation.tasks import cap, find_task, keys
from geort_drake.simulation.trial import after_play, seen_fingertips, select_reachable

GAIN = 1.5
# Of a scenario: too short to grasp anything, long enough to run through every part.
TOO_SHORT = "{timeout: 0.3}"


@cache
def allegro() -> Hand:
    """The robot hand of the shipped scenario."""
    return Hand("allegro_right")


def stage_of(builder: DiagramBuilder, scenario: Scenario, description: HandDescription) -> Stage:
    """The stage of a grasp in a diagram; seed 0 places the object."""
    rng = np.random.default_rng(0)
    return find_task(scenario.task).add_stage(builder, scenario, description, None, RigidTransform(), rng)


def play() -> Recording:
    """A minute of synthetic play."""
    return synthesized(0, 60.0, 120.0)


@cache
def person_who_plays() -> HumanHand:
    """Who plays."""
    return HumanHand.fit(play())


def centred_map(hand: Hand | None = None) -> AffineIK:
    """The affine map of each fingertip with a known gain, for a robot hand, by default the Allegro."""
    hand = hand or allegro()
    retarget = AffineIK(kinematics_of(hand), play().fingertips(hand.description.human_keypoints))
    retarget.gain = GAIN
    return retarget


# Found here, before any test replaces it: a goal is cached for all tests.
SEARCH = GraspPlanner.plans


@shared
def planned_grasp(object_name: str) -> tuple[GraspGoal, dict[str, float]]:
    """The planned grasp of an object in the shipped scenario, and the robot's joint angles in it, rad."""
    planner = GraspPlanner(scenario_with(object_name), allegro().description)
    # The goal does not hold the whole posture.
    robot, tried = planner._kinematics, []
    hand_pose = robot.hand_pose
    robot.hand_pose = lambda q: tried.append(q) or hand_pose(q)
    goal = SEARCH(planner, 2)[0]
    q = next(q for q in tried if hand_pose(q).IsExactlyEqualTo(goal.X_OB))
    return goal, robot.joint_positions(q)


def planned_goal(object_name: str) -> GraspGoal:
    """That grasp, whatever stands in for the planner."""
    return planned_grasp(object_name)[0]


def human_with(object_name: str = "cylinder", **changes) -> tuple[HumanHand, GraspGoal]:
    """A person who plans that grasp; `changes` are to the goal's fields."""
    return person_who_plays(), dataclasses.replace(planned_goal(object_name), **changes)


def reach_goal() -> GraspGoal:
    """A goal near the start with the fingers a little closed; no short trial touches it."""
    hand = allegro()
    tips = hand.fingertips(hand.default_position)
    X_OB = RigidTransform(RollPitchYaw(-1.92, 1.17, 2.15), [0.003, 0.005, 0.106])
    return GraspGoal(
        finger_names=tuple(hand.finger_names),
        touches=np.array([True, True, True, False]),
        X_OB=X_OB,
        X_OB_before=RigidTransform([0.0, -0.03, 0.12]) @ X_OB,
        clearance=0.012,
        p_BF_open=tips,
        p_OF_touch=X_OB.multiply(tips.T).T,
        n_OF=np.tile([1.0, 0.0, 0.0], (4, 1)),
        yaw_symmetry=0.0,
    )


def scenario_with(object_name: str = "cylinder", text: str = "{}") -> Scenario:
    """The shipped scenario with another object, and with YAML text merged in."""
    scenario = load_scenario(text=text)
    scenario.object.name = object_name
    return scenario


class Constant:
    """A retargeter that answers every hand with joint positions q, by default the starting ones."""

    def __init__(self, hand: Hand | None = None, q: np.ndarray | None = None):
        hand = hand or allegro()
        self.joint_names = list(hand.joint_names)
        self.q = hand.default_position if q is None else q

    def __call__(self, p_HK: np.ndarray) -> np.ndarray:
        return self.q.copy()


def resting_glove(duration: float, **metadata) -> Recording:
    """A hand at rest and a wrist that keep still, at 100 Hz."""
    hand = person_who_plays()
    t = np.arange(0, duration, 0.01)
    p_HK = hand.keypoints(FingerMotion(hand).rest)
    return Recording(
        t=t,
        p_HK=np.tile(p_HK, (len(t), 1, 1)),
        valid=np.ones(len(t), bool),
        X_WH=np.tile([1.0, 0, 0, 0, 0, 0, 0], (len(t), 1)),
        metadata={"side": "right", **metadata},
    )


def started(parts: TrialDiagram) -> Simulator:
    """A simulator at the beginning of a trial."""
    simulator = Simulator(parts.diagram)
    parts.initialize(simulator.get_mutable_context())
    return simulator


def judged(record: dict) -> dict:
    """A benchmark's line without the time that the trial took."""
    return {name: value for name, value in record.items() if name != "wall_time"}


def outcome_of(judgement: Judgement, until: float, begins: float = 0.0, **inputs: tuple) -> Outcome:
    """The outcome at the time `until`, s, of a task that begins at `begins`, s.

    Inputs are times (T,), s, and values (T, n), with lines between them.
    """
    outcome = Outcome(began=begins)
    for step in range(round((until - begins) / PERIOD) + 1):
        time = begins + step * PERIOD
        seen = {
            name: np.array([np.interp(time, t, column) for column in np.transpose(values)])
            for name, (t, values) in inputs.items()
        }
        outcome = judgement(outcome.replace(t=time), seen)
        if outcome.over:
            break
    return outcome


@shared
def plans(task: str) -> list:
    """A finger task's plans for the Allegro hand, the best first."""
    planner = {"keys": keys.plans, "cap": lambda description: cap.CapPlanner(description).plans()}[task]
    return planner(allegro().description)


def plan_once(patch, *tasks: str) -> None:
    """Lets these tasks' stages find the goals for the Allegro hand without a search; others plan as usual."""
    for task in tasks:
        planned = goals(task)  # before the patch, which would answer its own question
        patch.setattr(find_task(task), "plans", lambda scenario, description, planned=planned: planned)


@shared
def goals(task: str) -> list:
    """A task's goals for the Allegro hand, the best first."""
    if task not in ("pick_place", "peg"):
        return [planned_goal("cylinder")] if task == "grasp" else [plan.goal for plan in plans(task)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(GraspPlanner, "plans", SEARCH)  # other tests would get what a test puts in its place
        return find_task(task).plans(load_scenario(task=task), allegro().description)


@shared
def retarget_and_play(method: str) -> tuple[Any, FreePlay]:
    """A map without training for the person who plays, and what that person sees of it in free play."""
    frames = play().fingertips([4, 8, 12, 16])
    retarget = after_play(METHODS[method].fit(allegro(), frames), person_who_plays())
    return retarget, seen_fingertips(retarget, allegro(), person_who_plays())


def attempt(task: str, method: str, settings: str) -> tuple[TrialResult, bool]:
    """A person's trial of a finger task, and whether the plan that they keep was attainable."""
    retarget, seen = retarget_and_play(method)
    goal, attainable = select_reachable(goals(task), seen)
    scenario = load_scenario(task=task, text=settings)
    return run_trial(scenario, retarget, (person_who_plays(), goal))[0], attainable
