"""Decides at every update whether keypoints can be followed, and how fast after a hold."""

import dataclasses as dc
import math

import numpy as np

from geort_drake.settings import require_numbers

# Reasons why the input is not followed; states of `RetargetingSystem`.
HELD_LOST = "held: the glove lost the hand"
HELD_NOT_FINITE = "held: a keypoint or a joint target is not finite"
HELD_OUT_OF_RANGE = "held: a keypoint is farther from the wrist than a hand reaches"
HELD_STALE = "held: no newer keypoints arrived in time"
HELD_CLOCK = "held: the glove's clock ran backwards"
HELD_JUMPED = "held: a keypoint moved faster than a hand can"
# Frozen input is still followed; the motion after it is eased.
FROZEN = "frozen: the keypoints have not changed for too long"

# s; the allowed jump grows with the time between frames, up to this gap, the longest of common gloves.
_MAX_GAP = 0.04
# s; for rounding errors in sums of periods.
_TIME_TOLERANCE = 1e-9


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


@dc.dataclass(slots=True)
class GloveMemory:
    """The last usable keypoints and the last stamp, and when each last changed."""

    keypoints: np.ndarray  # (63,) m; NaN before the first
    changed: float  # when the keypoints last changed, s
    stamp: float  # on the glove's clock; NaN before the first
    stamped: float  # when the stamp last changed, s
    moved: float = math.nan  # largest change of a coordinate since the update before, m


def find_fault(
    checks: GloveChecks,
    memory: GloveMemory,
    time: float,
    period: float,
    keypoints: np.ndarray,
    valid: bool,
    stamp: float | None,
) -> str | None:
    """Returns the fault of the keypoints (63,), or None; updates `memory`.

    Args:
        time: time of this update, s.
        period: time since the last update, s.
        valid: whether the glove tracks the hand.
        stamp: time of measurement, s on the glove's clock; None if unknown.
    """
    fault = None
    if stamp is not None:
        if not math.isfinite(stamp):
            return HELD_NOT_FINITE
        if stamp < memory.stamp:
            fault = HELD_CLOCK
        if stamp != memory.stamp:
            memory.stamp, memory.stamped = stamp, time
        elif time - memory.stamped > checks.stale_after:
            fault = HELD_STALE
    if not valid:
        return HELD_LOST
    farthest = _largest(keypoints)  # NaN if any coordinate is NaN
    if not farthest <= checks.reach:
        return HELD_OUT_OF_RANGE if math.isfinite(farthest) else HELD_NOT_FINITE
    memory.moved = moved = _largest(keypoints - memory.keypoints)
    if moved != 0.0:
        gap = max(min(time - memory.changed, _MAX_GAP), period)
        if moved > checks.max_speed * gap:
            fault = fault or HELD_JUMPED
        memory.keypoints, memory.changed = keypoints, time
    elif time - memory.changed > checks.frozen_after:
        fault = fault or FROZEN
    return fault


def _largest(x: np.ndarray) -> float:
    """Returns the largest |x|, or NaN if any is NaN. (`argmax` is five times as fast as `max`.)"""
    size = np.abs(x)
    return size.item(size.argmax())


@dc.dataclass(slots=True)
class Easing:
    """Tracks whether the hand follows, is held, or follows again at limited speed.

    Input is followed once it has been good for the settling time. After a hold, the usable fraction of the
    joints' speed limit grows from zero to one over the duration of the hold.

    Attributes, all in s:
        good_since: when the input became good; NaN while it is bad.
        held_since: when the hold began; NaN while the hand follows.
        eased_from: when the last easing began.
        duration: duration of the easing; 0 if none is active.
    """

    good_since: float
    held_since: float
    eased_from: float = 0.0
    duration: float = 0.0

    @classmethod
    def at_start(cls, ease: bool) -> "Easing":
        """Returns the initial state: as after a long hold if `ease`, otherwise following."""
        return cls(math.nan, -math.inf) if ease else cls(-math.inf, math.nan)

    def follows(self) -> bool:
        """Whether the hand follows, as of the last update."""
        return math.isnan(self.held_since)

    def settled(self, time: float, settle_time: float) -> bool:
        """Notes good input at `time`; returns whether it has been good for `settle_time` (both s)."""
        if math.isnan(self.good_since):
            self.good_since = time
        return time - self.good_since >= settle_time - _TIME_TOLERANCE

    def hold(self, time: float, good: bool) -> None:
        """Holds the hand from `time` on, s; input that is not `good` has to settle anew."""
        if not good:
            self.good_since = math.nan
        if math.isnan(self.held_since):
            self.held_since = time

    def follow(self, time: float, period: float, longest: float) -> float:
        """Ends a hold with an easing of at most `longest`; all times in s.

        Returns:
            The usable fraction of the speed limit from `time` to `time + period`.
        """
        if not math.isnan(self.held_since):
            self.duration, self.eased_from = min(longest, time - self.held_since), time
            self.held_since = math.nan
        if self.duration > 0.0:
            return min((time - self.eased_from + period) / self.duration, 1.0)
        return 1.0

    def end(self) -> None:
        """Ends the easing."""
        self.duration = 0.0
