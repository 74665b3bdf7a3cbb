"""The goal of the trigger: where handle and pad are in the hand, and what the fingers do there."""

import dataclasses as dc

import numpy as np

from geort_drake.simulation.operators.goal import Goal

RADIUS, LENGTH = 0.018, 0.110  # m, of the handle
BACK = 0.034  # m, by which its back, two balls of the same radius on the palm, is off its axis
FINGERS = ("index", "middle", "ring")  # the first presses the pad, the others hold the handle


@dc.dataclass(frozen=True)
class TriggerGoal(Goal):
    """A handle between palm and fingers, and a pad on it under one fingertip.

    Frames: B the hand base; F a fingertip point. The handle's axis is along y of B.
    """

    trigger: int  # number of the finger that presses the pad
    # (3,) centre of the handle in B, m; and direction from the palm's side to the fingers' side.
    p_BH: np.ndarray
    n_B: np.ndarray
    # (F, 3) fingertip points in B, m: off handle and pad; and touching the handle, or on the pad as far
    # down as wanted.
    p_BF_open: np.ndarray
    p_BF_touch: np.ndarray
    # Wanted travel of the pad, m.
    travel: float

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return self.p_BF_open, self.p_BF_touch
