"""The goal of the trigger: where handle and pad are in the hand, and what the fingers do there."""

import dataclasses as dc

import numpy as np

from geort_drake.people.keypoints import mirrored
from geort_drake.simulation.operators.perception import FreePlay

RADIUS, LENGTH = 0.018, 0.110  # m, of the handle
BACK = 0.034  # m, by which its back, two balls of the same radius on the palm, is off its axis
FINGERS = ("index", "middle", "ring")  # the first presses the pad, the others hold the handle


@dc.dataclass(frozen=True)
class TriggerGoal:
    """A handle between palm and fingers, and a pad on it under one fingertip.

    Frames: B the hand base; F a fingertip point. The handle's axis is along y of B.
    """

    # Robot fingers, in the hand description's order.
    finger_names: tuple[str, ...]
    # Number of the finger that presses the pad, and (F,) whether a finger presses or holds.
    trigger: int
    touches: np.ndarray
    # (3,) centre of the handle in B, m; and direction from the palm's side to the fingers' side.
    p_BH: np.ndarray
    n_B: np.ndarray
    # (F, 3) fingertip points in B, m, which free play may miss by `clearance`: off handle and pad; and
    # touching the handle, or on the pad as far down as wanted. Those of other fingers do not matter.
    p_BF_open: np.ndarray
    p_BF_touch: np.ndarray
    clearance: float
    # Wanted travel of the pad, m.
    travel: float
    # What the person saw before.
    play: FreePlay | None = None

    def mirrored(self) -> "TriggerGoal":
        """Returns the goal reflected in the xz-planes of its frames; the person's own hand is not."""
        play = self.play and self.play._replace(p_BF=mirrored(self.play.p_BF))
        return dc.replace(
            self,
            play=play,
            p_BH=mirrored(self.p_BH),
            n_B=mirrored(self.n_B),
            p_BF_open=mirrored(self.p_BF_open),
            p_BF_touch=mirrored(self.p_BF_touch),
        )
