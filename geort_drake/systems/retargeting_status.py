"""States of `RetargetingSystem`."""

import dataclasses as dc
import math

from geort_drake.systems.glove_checks import (
    FROZEN,
    HELD_CLOCK,
    HELD_JUMPED,
    HELD_LOST,
    HELD_NOT_FINITE,
    HELD_OUT_OF_RANGE,
    HELD_STALE,
)
from geort_drake.systems.port_values import Immutable

TRACKING = "tracking"
LIMITED = "limited: a joint is at a limit of its position, speed or acceleration"
OUTSIDE = "outside: a fingertip is far from all its positions in training"
EASING = "easing: the joints catch up at reduced speed after a hold"
SETTLING = "held: the input has not been good for long enough"
MEASURING = "held: the person's hand is being measured"
HELD_OTHER_PERSON = "held: the hand is another person's, for whom the map has not been measured"
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


@dc.dataclass(frozen=True)
class RetargetingStatus(Immutable):
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
