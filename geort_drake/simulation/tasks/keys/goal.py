"""The goal of the keys: where the keys are in the hand, and which finger presses which."""

import dataclasses as dc

import numpy as np

from geort_drake.simulation.operators.goal import Goal

# Size of a key cap along and across the fingers, and distance between the centres of neighbours, m.
CAP_LENGTH, CAP_WIDTH, PITCH = 0.040, 0.018, 0.045
FINGERS = ("index", "middle", "ring")  # finger of each key, from the thumb's side


@dc.dataclass(frozen=True)
class KeysGoal(Goal):
    """Three keys under the fingertips of a parked hand.

    Frames: B the hand base; F a fingertip point. Keys are pressed along +x of B, out of the palm.
    """

    # (3, 3) centre of each key's top at rest in B, m.
    p_BK: np.ndarray
    # (F,) key of each finger, -1 for none.
    key_of: np.ndarray
    # (F, 3) fingertips in B above the keys and on pressed keys, m.
    p_BF_open: np.ndarray
    p_BF_pressed: np.ndarray

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return self.p_BF_open, self.p_BF_pressed
