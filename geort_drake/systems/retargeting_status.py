"""States of `RetargetingSystem`: what it follows, and why it holds."""

import math
from typing import NamedTuple

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
