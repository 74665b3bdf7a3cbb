"""Free play of the simulated person: they see where fingertips go, and select a plan."""

import dataclasses as dc
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from geort_drake.hands.hand import Hand
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.play import synthesize_play
from geort_drake.retargeting.base import forget
from geort_drake.retargeting.universal import UniversalRetargeter
from geort_drake.simulation.person.goal import Goal, Intended
from geort_drake.simulation.person.perception import FreePlay

DURATION, RATE = 30.0, 30.0  # s, frames per second


@functools.lru_cache(maxsize=32)  # a solid hand takes seconds, for each function and method
def _frames(person: HumanHand, duration: float) -> np.ndarray:
    """Returns keypoints (T, 21, 3) of free play, m in H."""
    return synthesize_play(seed=0, duration_s=duration, rate_hz=RATE, hand=person).p_HK.astype(float)


def seen_fingertips(
    retarget: Callable[[np.ndarray], np.ndarray], hand: Hand, person: HumanHand, latency: float = 0.0
) -> FreePlay:
    """Returns the person's and the robot's fingertips during free play; none if the method raises.

    Args:
        retarget: the method; for a universal map, the result of `after_play`.
        latency: latency of the method, s; if it exceeds the time between frames, the method gets fewer.
    """
    forget(retarget)
    frames = _frames(person, DURATION)
    stride = max(1, math.ceil(latency * RATE))
    frames = frames[::stride]
    order = [list(retarget.joint_names).index(name) for name in hand.joint_names]  # type: ignore[attr-defined]
    try:
        q = np.array([retarget(frame) for frame in frames])[:, order]
    except Exception:  # a method may raise anything; its trials record the error
        q = np.empty((0, len(order)))
    finite = np.isfinite(q).all(axis=1)
    tips = [4 * FINGER_NAMES.index(name) + 4 for name in hand.finger_names]
    p_HF = frames[: len(q)][finite][:, tips]
    p_BF = hand.fingertips(np.clip(q[finite], hand.lower, hand.upper))
    return FreePlay(p_HF, p_BF, stride / RATE)


def after_play(retarget: Any, person: HumanHand) -> Any:
    """Returns the map after free play: a universal map adapted to the person, any other as it is."""
    return (
        retarget.for_person(_frames(person, DURATION))
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
