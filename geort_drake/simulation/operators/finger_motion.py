"""Inverse kinematics of a human hand along natural finger postures."""

import numpy as np

from geort_drake.people.human_hand import HumanHand

# Bend of the outer joint over that of the joint before it: two thirds in fingers (textbook; 0.4 to 0.85 in
# recorded play), one in the thumb (recorded play).
_COUPLING = np.array([1.0, 2 / 3, 2 / 3, 2 / 3, 2 / 3])
# A straight finger is singular: no small motion of its joints shortens it.
_LEAST_BEND = np.deg2rad(8.0)
# Steps are damped where a radian moves the tip by less than 2 mm.
_DAMPING = (2e-3) ** 2 * np.eye(3)


class FingerMotion:
    """Inverse kinematics of a human hand in three coordinates per finger, within its joint limits.

    The coordinates are abduction, flexion of the base joint, and a bend shared by both outer joints
    (`_COUPLING`), so every fingertip position has one natural posture.
    """

    def __init__(self, hand: HumanHand):
        self._hand = hand
        lower, upper = hand.lower.reshape(5, 4), hand.upper.reshape(5, 4)
        # The shared bend ends where one of the two joints reaches its limit.
        bend_lower = np.maximum(np.maximum(lower[:, 2], lower[:, 3] / _COUPLING), _LEAST_BEND)
        bend_upper = np.minimum(upper[:, 2], upper[:, 3] / _COUPLING)
        self._lower = np.column_stack([lower[:, :2], np.minimum(bend_lower, bend_upper)])
        self._upper = np.column_stack([upper[:, :2], np.maximum(bend_lower, bend_upper)])

    @property
    def rest(self) -> np.ndarray:
        """(20,) joint angles with every coordinate in the middle of its range, rad."""
        return self._angles(0.5 * (self._lower + self._upper))

    def follow(self, theta: np.ndarray, p_HF: np.ndarray, iterations: int = 2) -> np.ndarray:
        """Joint angles (20,) near `theta` that bring the fingertips to p_HF (5, 3), m, or near it.

        Takes damped Gauss–Newton steps. A coordinate at its limit stays there; the others continue.
        """
        x = np.clip(np.asarray(theta, float).reshape(5, 4)[:, :3], self._lower, self._upper)
        for _ in range(iterations):
            theta = self._angles(x)
            error = (p_HF - self._hand.fingertips(theta))[..., None]
            J = self._hand.fingertip_jacobians(theta)
            J = np.concatenate([J[..., :2], J[..., 2:3] + _COUPLING[:, None, None] * J[..., 3:4]], axis=-1)
            free = np.ones((5, 3))
            for _ in range(2):
                Jf = J * free[:, None, :]
                step = (Jf.swapaxes(1, 2) @ np.linalg.solve(Jf @ Jf.swapaxes(1, 2) + _DAMPING, error))[..., 0]
                moved = x + step
                within = (moved >= self._lower) & (moved <= self._upper)
                if within.all():
                    break
                free *= within
            x = np.clip(moved, self._lower, self._upper)
        return self._angles(x)

    def _angles(self, x: np.ndarray) -> np.ndarray:
        theta = np.empty((5, 4))
        theta[:, :3], theta[:, 3] = x, _COUPLING * x[:, 2]
        return theta.ravel()
