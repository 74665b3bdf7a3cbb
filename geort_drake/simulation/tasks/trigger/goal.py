"""The goal of the trigger: where handle and pad are in the hand, and where the fingers touch them."""

import dataclasses as dc

import numpy as np

from geort_drake.simulation.operators.goal import Goal

RADIUS, LENGTH = 0.018, 0.110  # m, of the handle
BACK = 0.034  # m, distance of the handle's axis from its back, two balls of the same radius on the palm
FINGERS = ("index", "middle", "ring")  # the first presses the pad, the others hold the handle


@dc.dataclass(frozen=True)
class TriggerGoal(Goal):
    """A handle between palm and fingers, and a pad on it under one fingertip.

    Frames: B the hand base; F a fingertip point. The handle's axis is along y of B.
    """

    trigger: int  # index of the finger that presses the pad
    # (3,) centre of the handle in B, m; and unit vector from the palm's side to the fingers' side.
    p_BH: np.ndarray
    n_B: np.ndarray
    # (F, 3) fingertips in B, m: off handle and pad; and touching the handle, or on the pad at its wanted
    # travel.
    p_BF_open: np.ndarray
    p_BF_touch: np.ndarray
    # Wanted travel of the pad, m.
    travel: float

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return self.p_BF_open, self.p_BF_touch
