"""Whether a glove's keypoints can be followed, judged from one update to the next."""

import dataclasses as dc
import math

import numpy as np

# States of the retargeting that the input decides.
HELD_LOST = "held: the glove lost the hand"
HELD_NOT_FINITE = "held: a keypoint or a joint target is not finite"
HELD_OUT_OF_RANGE = "held: a keypoint is farther from the wrist than a hand reaches"
HELD_STALE = "held: no newer keypoints arrived in time"
HELD_CLOCK = "held: the glove's clock ran backwards"
HELD_JUMPED = "held: a keypoint moved faster than a hand can"
# Followed all the same, as there is nothing to follow; what comes after it is eased.
FROZEN = "frozen: the keypoints have not changed for too long"

# Gloves send at least 25 times a second, so a longer gap allows no farther jump, s.
_LONGEST_GAP = 0.04


@dc.dataclass
class GloveChecks:
    """Which input is followed, and how following begins."""

    # A coordinate of a keypoint beyond this is no hand's, m: from the wrist to a tall man's middle
    # fingertip it is 0.22 m.
    reach: float = 0.3
    # A coordinate that changes faster is no motion, m/s: fastest in recorded glove play are 1.3 to 4.0 m/s.
    max_speed: float = 5.0
    # Keypoints equal to the last bit for so long are no live hand's, s.
    frozen_after: float = 0.5
    # Oldest keypoints that are followed where their time is known, s.
    stale_after: float = 0.2
    # The input must be good for so long before it is followed, s.
    settle_time: float = 0.03
    # Then the joints' speed limit grows from zero to full over the time that the hand was held, at most
    # this, s.
    ease_time: float = 0.5
    # Whether the start counts as the end of a long hold; if not, the first keypoints are followed at once.
    ease_at_start: bool = True
    # A fingertip farther from all places of its training is reported, m. The same person's new motions
    # stay within 0.01 m, another person's hand is 0.03 to 0.05 m away.
    trained_tolerance: float = 0.02

    def validate(self) -> None:
        """Raises ValueError for values that cannot work."""
        for field in dc.fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"checks.{field.name} must be finite and not negative, not {value}")


@dc.dataclass(slots=True)
class GloveMemory:
    """What is known of the input so far: the last usable keypoints, and when they came (s)."""

    keypoints: np.ndarray  # (63,), NaN before the first
    changed: float
    stamp: float  # of the glove's clock, NaN before the first
    stamped: float
    moved: float = math.nan  # how far a coordinate is from where it was at the update before, m


def judge(
    checks: GloveChecks,
    memory: GloveMemory,
    time: float,
    period: float,
    keypoints: np.ndarray,
    valid: bool,
    stamp: float | None,
) -> str | None:
    """What is wrong with the keypoints (63,) now, or None; brings `memory` up to date.

    Args:
        time: of this update, s; period: since the one before, s.
        valid: whether the glove says that it tracks the hand.
        stamp: time on the glove's clock at which the keypoints were measured, s; None where unknown.
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
    farthest = _largest(keypoints)  # NaN where a keypoint is
    if not farthest <= checks.reach:
        return HELD_OUT_OF_RANGE if math.isfinite(farthest) else HELD_NOT_FINITE
    memory.moved = moved = _largest(keypoints - memory.keypoints)
    if moved != 0.0:
        gap = max(min(time - memory.changed, _LONGEST_GAP), period)
        if moved > checks.max_speed * gap:
            fault = fault or HELD_JUMPED
        memory.keypoints, memory.changed = keypoints, time
    elif time - memory.changed > checks.frozen_after:
        fault = fault or FROZEN
    return fault


def _largest(x: np.ndarray) -> float:
    """The largest |x|; NaN where there is one. (`max` takes five times as long as `argmax`.)"""
    size = np.abs(x)
    return size.item(size.argmax())
