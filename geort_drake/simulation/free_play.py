"""Free play before a task: the person sees where the robot's fingertips go, and keeps a plan."""

import dataclasses as dc
import math
from collections.abc import Callable, Sequence

import numpy as np

from geort_drake.hands.model import HandModel
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.play import synthesize_play
from geort_drake.retargeting.universal import UniversalRetargeter
from geort_drake.simulation.tasks.grasp.goal import GraspGoal

DURATION, RATE = 30.0, 30.0  # s, looks per second


def seen_fingertips(
    retarget: Callable[[np.ndarray], np.ndarray], hand: HandModel, person: HumanHand, latency: float = 0.0
) -> np.ndarray:
    """Robot fingertips (T, F, 3), m in B, during the person's free play; none if the method fails in it.

    A method of longer `latency` (s) than a look is asked less often.
    """
    if callable(reset := getattr(retarget, "reset", None)):
        reset()
    frames = synthesize_play(seed=0, duration_s=DURATION, rate_hz=RATE, hand=person).p_HK.astype(float)
    frames = frames[:: max(1, math.ceil(latency * RATE))]
    order = [list(retarget.joint_names).index(name) for name in hand.joint_names]  # type: ignore[attr-defined]
    try:
        if isinstance(retarget, UniversalRetargeter):
            retarget = retarget.for_person(frames)
        q = np.array([retarget(frame) for frame in frames])[:, order]
    except Exception:  # of any method; its trials record the error
        q = np.empty((0, len(order)))
    return hand.fingertips(np.clip(q[np.isfinite(q).all(axis=1)], hand.lower, hand.upper))


def keep_attainable(plans: Sequence[GraspGoal], p_BF: np.ndarray) -> tuple[GraspGoal, bool]:
    """The plan whose open hand the person has seen within its clearance, and True.

    Each grasping fingertip counts by its least distance from its place in the open hand. If no plan is
    attainable, it is the nearest, which the person tries as near as the fingers come, and False.

    Args:
        plans: at least one, in the order of preference.
        p_BF: see `seen_fingertips`.
    """

    def excess(goal: GraspGoal) -> float:
        miss = np.linalg.norm(p_BF - goal.p_BF_open, axis=-1).min(axis=0, initial=np.inf)
        return max(float(miss[goal.touches].max() - goal.clearance), 0.0) if goal.clearance < np.inf else 0.0

    kept = min(plans, key=excess)
    attainable = excess(kept) == 0.0
    return kept if attainable else dc.replace(kept, clearance=np.inf), attainable
