"""Decides at every update whether keypoints can be followed."""

import dataclasses as dc
import math

import numpy as np

from geort_drake.settings import require_numbers
from geort_drake.systems.retargeting_status import (
    FROZEN,
    HELD_CLOCK,
    HELD_JUMPED,
    HELD_LOST,
    HELD_NOT_FINITE,
    HELD_OUT_OF_RANGE,
    HELD_STALE,
)

# s; the allowed jump grows with the time between frames, up to this gap, the longest of common gloves.
_MAX_GAP = 0.04

# Fields of the memory of `find_fault`.
GLOVE_FIELDS = [
    ("keypoints", float, 63),  # the last usable ones, m; NaN before the first
    ("changed", float),  # when they last changed, s
    ("stamp", float),  # the last one, s on the glove's clock; NaN before the first
    ("stamped", float),  # when it last changed, s
]


@dc.dataclass
class GloveChecks:
    """Thresholds of the checks on a glove's keypoints, and durations of settling and easing.

    Attributes:
        reach: largest coordinate of a keypoint, m; wrist to middle fingertip is 0.22 m for a tall man.
        max_speed: largest speed of a coordinate, m/s; recorded glove play peaks at 1.3 to 4.0 m/s.
        frozen_after: keypoints that stay bitwise equal for this long are frozen, s.
        stale_after: largest age of keypoints whose measurement time is known, s.
        settle_time: the input must be good for this long before it is followed, s.
        ease_time: after a hold, the joints' speed limit grows from zero over the hold's duration, at most
            this, s.
        ease_at_start: whether the start counts as the end of a long hold; otherwise the first keypoints are
            followed at once.
        trained_tolerance: a fingertip farther than this from its training data is reported, m. New motions of
            the same person stay within 0.01 m; another person's hand is 0.03 to 0.05 m away.
    """

    reach: float = 0.3
    max_speed: float = 5.0
    frozen_after: float = 0.5
    stale_after: float = 0.2
    settle_time: float = 0.03
    ease_time: float = 0.5
    ease_at_start: bool = True
    trained_tolerance: float = 0.02

    def validate(self) -> None:
        """Raises ValueError for a value out of range."""
        require_numbers(self, "checks", may_be_zero=True)


def find_fault(
    checks: GloveChecks,
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
        elif time - memory["stamped"] > checks.stale_after:
            fault = HELD_STALE
    if not valid:
        return HELD_LOST
    if not np.isfinite(keypoints).all():
        return HELD_NOT_FINITE
    if np.abs(keypoints).max() > checks.reach:
        return HELD_OUT_OF_RANGE
    moved = np.abs(keypoints - memory["keypoints"]).max()  # NaN for the first keypoints
    if moved != 0.0:
        gap = max(min(time - memory["changed"], _MAX_GAP), period)
        if moved > checks.max_speed * gap:
            fault = fault or HELD_JUMPED
        memory["keypoints"], memory["changed"] = keypoints, time
    elif time - memory["changed"] > checks.frozen_after:
        fault = fault or FROZEN
    return fault
