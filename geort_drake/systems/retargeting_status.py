"""States of `RetargetingSystem`."""

import dataclasses as dc
import functools
import math

import numpy as np

from geort_drake.retargeting.trained_space import TrainedSpace
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
LEARNING = "learning: the map is adapting to the person"
UNUSUAL = "unusual: the hand differs from all hands in training"
EASING = "easing: the joints catch up at reduced speed after a hold"
SETTLING = "held: the input has not been good for long enough"
HELD_OTHER_PERSON = "held: the hand is another person's; the map adapts to it"
FOLLOWED = (TRACKING, LIMITED, OUTSIDE, LEARNING, UNUSUAL, EASING)
STATES = (
    *FOLLOWED,
    SETTLING,
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
        p_HK: keypoints (21, 3), m in H, for which `distance` is computed; None while the input is not
            followed.
        trained_space: the fingertips' positions in training; None if they are unknown.
        unusual: what is unusual about the hand, in words; empty if nothing is, or for a map of one person.
    """

    state: str = SETTLING
    since: float = 0.0
    p_HK: np.ndarray | None = dc.field(default=None, repr=False, compare=False)
    trained_space: TrainedSpace | None = dc.field(default=None, repr=False, compare=False)
    unusual: str = ""

    @functools.cached_property
    def distance(self) -> float:
        """Largest distance of a fingertip from its positions in training, m.

        NaN if these positions are unknown or the input is not followed. Computed on first use, because it
        takes longer than the rest of a status.
        """
        if self.p_HK is None or self.trained_space is None:
            return math.nan
        return self.trained_space.distances(self.p_HK).max().item()
