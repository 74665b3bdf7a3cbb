"""The goal of the cap: where it is in the hand, and where the fingers turn it."""

import dataclasses as dc

import numpy as np

from geort_drake.simulation.operators.goal import Goal

RADIUS, HEIGHT = 0.020, 0.025  # m
FINGERS = ("thumb", "index", "middle")


@dc.dataclass(frozen=True)
class CapGoal(Goal):
    """A cap between the fingertips of a parked hand.

    Frames: B the hand base; F a fingertip point. The cap's axis is along x of B. The cap rises along −x when
    it is unscrewed.
    """

    thumb: int  # index of the thumb
    # (3,) middle of the cap in B, m.
    p_BC: np.ndarray
    # (F, 3) fingertips in B that touch the cap at the beginning of a stroke, m.
    p_BF_touch: np.ndarray
    # Turn of the cap in a stroke about −x of B, rad, and distance of open fingertips from the cap, m.
    stroke: float
    gap: float

    @property
    def p_BF_open(self) -> np.ndarray:
        """(F, 3) open fingertips in B at the beginning of a stroke, m."""
        return self.fingertips(0.0, -self.gap)

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return self.p_BF_open, self.fingertips(self.stroke, -self.gap)

    def fingertips(self, turn: float, depth: float | np.ndarray) -> np.ndarray:
        """Returns fingertips (F, 3) in B around the cap, m.

        Args:
            turn: turn since the beginning of the stroke, rad.
            depth: number or (F,), depth below the surface, m: of the thumb towards the axis, of the others
                towards the thumb.
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
