"""The goal of the keys: where they are in the hand, and which finger presses which."""

import dataclasses as dc

import numpy as np

from geort_drake.people.keypoints import mirrored
from geort_drake.simulation.operators.perception import FreePlay

# Of the row: caps along the fingers and across them, m, and the distance between neighbours' centres.
CAP_LENGTH, CAP_WIDTH, PITCH = 0.040, 0.018, 0.045
FINGERS = ("index", "middle", "ring")  # key by key, from the thumb's side


@dc.dataclass(frozen=True)
class KeysGoal:
    """Three keys under the fingertips of a parked hand.

    Frames: B the hand base; F a fingertip point. Keys are pressed along +x of B, out of the palm.
    """

    # Robot fingers, in the hand description's order.
    finger_names: tuple[str, ...]
    # (3, 3) centre of each key's top at rest in B, m.
    p_BK: np.ndarray
    # (F,) key of each finger, -1 for none.
    key_of: np.ndarray
    # (F, 3) fingertip points in B above the keys and on pressed keys, m, which free play may miss by
    # `clearance`; those of other fingers do not matter.
    p_BF_open: np.ndarray
    p_BF_pressed: np.ndarray
    clearance: float
    # What the person saw before.
    play: FreePlay | None = None

    @property
    def touches(self) -> np.ndarray:
        """(F,) whether a finger has a key."""
        return self.key_of >= 0

    def mirrored(self) -> "KeysGoal":
        """Returns the goal reflected in the xz-planes of its frames; the person's own hand is not."""
        play = self.play and self.play._replace(p_BF=mirrored(self.play.p_BF))
        return dc.replace(self, p_BK=mirrored(self.p_BK), p_BF_open=mirrored(self.p_BF_open), play=play)
