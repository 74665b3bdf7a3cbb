"""The goal of the cap: where it is in the hand, and where the fingers turn it."""

import dataclasses as dc

import numpy as np

from geort_drake.people.keypoints import mirrored
from geort_drake.simulation.operators.perception import FreePlay

RADIUS, HEIGHT = 0.020, 0.025  # m
FINGERS = ("thumb", "index", "middle")


@dc.dataclass(frozen=True)
class CapGoal:
    """A cap between the fingertips of a parked hand.

    Frames: B the hand base; F a fingertip point. The cap's axis is along x of B. Unscrewed, the cap rises
    along −x.
    """

    # Robot fingers, in the hand description's order, (F,) whether a finger holds the cap, and which is the
    # thumb.
    finger_names: tuple[str, ...]
    touches: np.ndarray
    thumb: int
    # (3,) middle of the cap in B, m.
    p_BC: np.ndarray
    # (F, 3) fingertip points in B that touch the cap when a stroke begins, m. Those of other fingers do not
    # matter.
    p_BF_touch: np.ndarray
    # Turn of the cap in a stroke about −x of B, rad, and distance of open fingertips from it, m.
    stroke: float
    gap: float
    # By which free play may miss the open fingertips at either end of a stroke, m.
    clearance: float
    # What the person saw before.
    play: FreePlay | None = None

    @property
    def p_BF_open(self) -> np.ndarray:
        """(F, 3) open fingertips when a stroke begins, m in B."""
        return self.fingertips(0.0, -self.gap)

    def fingertips(self, turn: float, depth: float | np.ndarray) -> np.ndarray:
        """(F, 3) fingertip points in B, m, around the cap.

        Args:
            turn: from the beginning of a stroke, rad.
            depth: one or (F,), inwards from the surface, m: the thumb towards the axis, the others against
                the thumb.
        """
        p = self.p_BF_touch - self.p_BC
        inwards = -p[self.thumb] / np.linalg.norm(p[self.thumb])
        signs = np.where(np.arange(len(p)) == self.thumb, 1.0, -1.0)
        p = p + np.outer(signs * depth, inwards)
        c, s = np.cos(turn), np.sin(turn)
        turned = p.copy()
        turned[:, 1], turned[:, 2] = c * p[:, 1] + s * p[:, 2], c * p[:, 2] - s * p[:, 1]
        return self.p_BC + np.where(self.touches[:, None], turned, self.p_BF_touch - self.p_BC)

    def mirrored(self) -> "CapGoal":
        """Returns the goal reflected in the xz-planes of its frames; the person's own hand is not."""
        play = self.play and self.play._replace(p_BF=mirrored(self.play.p_BF))
        return dc.replace(
            self,
            play=play,
            p_BC=mirrored(self.p_BC),
            p_BF_touch=mirrored(self.p_BF_touch),
            stroke=-self.stroke,
        )
