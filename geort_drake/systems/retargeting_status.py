"""States of `RetargetingSystem`: what it follows, and why it holds; and the checks of a glove's keypoints."""

import math
from typing import NamedTuple

import numpy as np

TRACKING = "tracking"
LIMITED = "limited: a joint is at a limit of its position, speed or acceleration"
OUTSIDE = "outside: a fingertip is far from all its positions in training"
EASING = "easing: the joints catch up at reduced speed after a hold"
SETTLING = "held: the input has not been good for long enough"
MEASURING = "held: the person's hand is being measured"
HELD_OTHER_PERSON = "held: the hand is another person's, for whom the map has not been measured"
HELD_LOST = "held: the glove lost the hand"
HELD_NOT_FINITE = "held: a keypoint or a joint target is not finite"
HELD_OUT_OF_RANGE = "held: a keypoint is farther from the wrist than a hand reaches, or not in its frame"
HELD_STALE = "held: no newer keypoints arrived in time"
HELD_CLOCK = "held: the glove's clock ran backwards"
HELD_JUMPED = "held: a keypoint moved faster than a hand can"
# Frozen input is still followed; the motion after it is eased.
FROZEN = "frozen: the keypoints have not changed for too long"
FOLLOWED = (TRACKING, LIMITED, OUTSIDE, EASING)
STATES = (
    *FOLLOWED,
    SETTLING,
    MEASURING,
    HELD_OTHER_PERSON,
    HELD_LOST,
    HELD_NOT_FINITE,
    HELD_OUT_OF_RANGE,
    HELD_STALE,
    HELD_CLOCK,
    HELD_JUMPED,
    FROZEN,
)

# Thresholds of the checks on a glove's keypoints.
REACH = 0.3  # m, largest coordinate of a keypoint; wrist to middle fingertip is 0.22 m for a tall man
MAX_SPEED = 5.0  # m/s, of a coordinate; recorded glove play peaks at 1.3 to 4.0 m/s
FROZEN_AFTER = 0.5  # s; keypoints that stay bitwise equal for this long are frozen
STALE_AFTER = 0.2  # s, largest age of keypoints whose measurement time is known
# s; the allowed jump grows with the time between frames, up to this gap, the longest of common gloves.
_MAX_GAP = 0.04

# Fields of the memory of `find_fault`.
GLOVE_FIELDS = [
    ("keypoints", float, 63),  # the last usable ones, m; NaN before the first
    ("changed", float),  # when they last changed, s
    ("stamp", float),  # the last one, s on the glove's clock; NaN before the first
    ("stamped", float),  # when it last changed, s
]


class RetargetingStatus(NamedTuple):
    """How the system reacts to the present input, and since when.

    Attributes:
        state: one of `STATES`, such as `TRACKING`.
        since: time at which this state began, s.
        distance: largest distance of a fingertip from its positions in training, m, at most 0.1 s old; NaN if
            these positions are unknown or the input is not followed.
    """

    state: str = SETTLING
    since: float = 0.0
    distance: float = math.nan


def find_fault(
    memory: np.void,
    time: float,
    period: float,
    keypoints: np.ndarray,
    valid: bool,
    stamp: float | None,
) -> str | None:
    """Returns the fault of the keypoints (63,), or None; updates `memory`.

    Args:
        memory: a record with the fields `GLOVE_FIELDS`.
        time: time of this update, s.
        period: time since the last update, s.
        valid: whether the glove tracks the hand.
        stamp: time of measurement, s on the glove's clock; None if unknown.
    """
    fault = None
    if stamp is not None:
        if not math.isfinite(stamp):
            return HELD_NOT_FINITE
        if stamp < memory["stamp"]:
            fault = HELD_CLOCK
        if stamp != memory["stamp"]:
            memory["stamp"], memory["stamped"] = stamp, time
        elif time - memory["stamped"] > STALE_AFTER:
            fault = HELD_STALE
    if not valid:
        return HELD_LOST
    if not np.isfinite(keypoints).all():
        return HELD_NOT_FINITE
    if np.abs(keypoints).max() > REACH:
        return HELD_OUT_OF_RANGE
    distance = np.abs(keypoints - memory["keypoints"]).max()  # NaN for the first keypoints
    if distance != 0.0:
        gap = max(min(time - memory["changed"], _MAX_GAP), period)
        if distance > MAX_SPEED * gap:
            fault = fault or HELD_JUMPED
        memory["keypoints"], memory["changed"] = keypoints, time
    elif time - memory["changed"] > FROZEN_AFTER:
        fault = fault or FROZEN
    return fault
