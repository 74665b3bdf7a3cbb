"""A person and a known map, with which whole grasps are tested without training anything."""

import dataclasses
from functools import cache

import numpy as np
from affine_map import AffineMap
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.play import synthesize_play
from geort_drake.people.recording import Recording
from geort_drake.simulation.diagram import GraspDiagram
from geort_drake.simulation.operators.finger_motion import FingerMotion
from geort_drake.simulation.scenario import Scenario, load_scenario
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner

GAIN = 1.5
# Of a scenario: too short to grasp anything, long enough to run through every part.
TOO_SHORT = "{timeout: 0.3}"


@cache
def allegro() -> HandModel:
    """The robot hand of the shipped scenario."""
    return HandModel(load_hand("allegro_right"))


@cache
def person_and_rest() -> tuple[HumanHand, np.ndarray]:
    """A person fitted to a minute of play, and the mean of their fingertips, (4, 3) m in H."""
    play = synthesize_play(seed=0, duration_s=60)
    return HumanHand.fit(play), play.fingertips([4, 8, 12, 16]).mean(axis=0)


def centred_map(hand: HandModel | None = None) -> AffineMap:
    """A fresh affine map that takes the human cloud's centre to the middle of a robot hand's workspace.

    Args:
        hand: the Allegro hand if None. Its first fingers are those of `person_and_rest`.
    """
    hand = hand or allegro()
    _, rest = person_and_rest()
    mirror = np.diag([1.0, -1.0 if hand.description.side == "left" else 1.0, 1.0])
    offset = workspace_centre(hand.description.name) - hand.fingertips(hand.default_position)
    return AffineMap(hand, rest, GAIN, mirror, offset)


@cache
def workspace_centre(hand_name: str) -> np.ndarray:
    """(4, 3) mean robot fingertips in B over uniform joint positions, m."""
    hand = HandModel(load_hand(hand_name))
    q = np.random.default_rng(0).uniform(hand.lower, hand.upper, (2000, len(hand.joint_names)))
    return hand.fingertips(q).mean(axis=0)


@cache
def planned_goal(object_name: str) -> GraspGoal:
    """The planned grasp of an object in the shipped scenario."""
    return GraspPlanner(scenario_with(object_name), allegro().description).plan()


def goal_at_any_error(object_name: str) -> GraspGoal:
    """The same; the person approaches however far the fingers are from the open hand."""
    return dataclasses.replace(planned_goal(object_name), clearance=np.inf)


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

    def __init__(self, hand: HandModel | None = None, q: np.ndarray | None = None):
        hand = hand or allegro()
        self.joint_names = list(hand.joint_names)
        self.q = hand.default_position if q is None else q

    def __call__(self, p_HK: np.ndarray) -> np.ndarray:
        return self.q.copy()


def resting_glove(duration: float, **metadata) -> Recording:
    """A hand at rest and a wrist that keep still, at 100 Hz."""
    hand, _ = person_and_rest()
    t = np.arange(0, duration, 0.01)
    p_HK = hand.keypoints(FingerMotion(hand).rest)
    return Recording(
        t=t,
        p_HK=np.tile(p_HK, (len(t), 1, 1)),
        valid=np.ones(len(t), bool),
        X_WH=np.tile([1.0, 0, 0, 0, 0, 0, 0], (len(t), 1)),
        metadata={"side": "right", **metadata},
    )


def started(parts: GraspDiagram) -> Simulator:
    """A simulator at the beginning of a trial."""
    simulator = Simulator(parts.diagram)
    parts.initialize(simulator.get_mutable_context())
    return simulator


def in_this_process(function, arguments, *_, **__):
    """`call_in_workers` without workers."""
    return (function(*each) for each in arguments)


def judged(record: dict) -> dict:
    """A benchmark's line without the time that the trial took."""
    return {name: value for name, value in record.items() if name != "wall_time"}
