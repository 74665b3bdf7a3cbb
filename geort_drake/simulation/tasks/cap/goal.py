"""The goal of the cap: where it is in the hand, and where the fingers turn it."""

import dataclasses as dc

import numpy as np

from geort_drake.simulation.operators.goal import Goal

RADIUS, HEIGHT = 0.020, 0.025  # m
FINGERS = ("thumb", "index", "middle")


@dc.dataclass(frozen=True)
class CapGoal(Goal):
    """A cap between the fingertips of a parked hand.

    Frames: B the hand base; F a fingertip point. The cap's axis is along x of B. Unscrewed, the cap rises
    along −x.
    """

    thumb: int  # its number
    # (3,) middle of the cap in B, m.
    p_BC: np.ndarray
    # (F, 3) fingertip points in B that touch the cap when a stroke begins, m.
    p_BF_touch: np.ndarray
    # Turn of the cap in a stroke about −x of B, rad, and distance of open fingertips from it, m.
    stroke: float
    gap: float

    @property
    def p_BF_open(self) -> np.ndarray:
        """(F, 3) open fingertips when a stroke begins, m in B."""
        return self.fingertips(0.0, -self.gap)

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return self.p_BF_open, self.fingertips(self.stroke, -self.gap)

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
        return dc.replace(super().mirrored(), stroke=-self.stroke)
