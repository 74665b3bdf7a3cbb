"""Inverse kinematics of a human hand along natural finger postures."""

import numpy as np

from geort_drake.people.synthetic.hand import BEND_RATIO, HumanHand

# A straight finger is singular: no small motion of its joints shortens it.
_MIN_BEND = np.deg2rad(8.0)
# Steps are damped where a radian moves the tip by less than 2 mm.
_DAMPING = (2e-3) ** 2 * np.eye(3)


def limited(velocity: np.ndarray, limit: np.ndarray | float) -> np.ndarray:
    """Returns velocities (n, 3) scaled down to at most `limit`, a number or (n, 1); same units."""
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    return velocity * np.minimum(1.0, limit / np.maximum(speed, 1e-9))


class FingerMotion:
    """Inverse kinematics of a human hand in three coordinates per finger, within its joint limits.

    The coordinates are abduction, flexion of the base joint, and a bend shared by both outer joints
    (`BEND_RATIO`), so every fingertip position has one natural posture.
    """

    def __init__(self, hand: HumanHand):
        self._hand = hand
        lower, upper = hand.lower.reshape(5, 4), hand.upper.reshape(5, 4)
        # The shared bend ends where one of the two joints reaches its limit.
        bend_lower = np.maximum(np.maximum(lower[:, 2], lower[:, 3] / BEND_RATIO), _MIN_BEND)
        bend_upper = np.minimum(upper[:, 2], upper[:, 3] / BEND_RATIO)
        self._lower = np.column_stack([lower[:, :2], np.minimum(bend_lower, bend_upper)])
        self._upper = np.column_stack([upper[:, :2], np.maximum(bend_lower, bend_upper)])
        self._R_BH = hand.R_HB.transpose(0, 2, 1)
        self._twist = np.cos(hand.twist), np.sin(hand.twist)

    @property
    def rest(self) -> np.ndarray:
        """(20,) joint angles with every coordinate in the middle of its range, rad."""
        return self._angles(0.5 * (self._lower + self._upper))

    def follow(self, theta: np.ndarray, p_HF: np.ndarray, iterations: int = 2) -> np.ndarray:
        """Returns joint angles (20,) near `theta`, rad, that bring the fingertips to or near p_HF (5, 3), m.

        Takes damped Gauss–Newton steps. A coordinate at its limit stays there; the others continue.
        """
        x = np.minimum(np.maximum(np.reshape(theta, (5, 4))[:, :3], self._lower), self._upper)
        p_BF = self._R_BH @ (p_HF - self._hand.p_HB)[..., None]
        for _ in range(iterations):
            tips, J = self._tips_and_jacobians(x)
            error = p_BF - tips[..., None]
            moved = self._step(x, J, error)
            within = (moved >= self._lower) & (moved <= self._upper)
            if np.count_nonzero(within) < within.size:
                moved = self._step(x, J * within[:, None], error)
            x = np.minimum(np.maximum(moved, self._lower), self._upper)
        return self._angles(x)

    def _step(self, x: np.ndarray, J: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Returns coordinates (5, 3) after a damped step that reduces `error` (5, 3, 1), m."""
        Jt = J.swapaxes(1, 2)
        return x + (Jt @ np.linalg.solve(J @ Jt + _DAMPING, error))[..., 0]

    def _tips_and_jacobians(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns fingertips (5, 3), m, in the fingers' base frames, and Jacobians (5, 3, 3) by x (5, 3).

        The formulas are those of `HumanHand`, in fewer and smaller operations.
        """
        abduction, flexion, bend = x.T
        angles = np.array([abduction, flexion, bend, (1.0 + BEND_RATIO) * bend])
        (sa, sf, s1, s2), (ca, cf, c1, c2) = np.sin(angles), np.cos(angles)
        ct, st = self._twist
        first, middle, last = self._hand.lengths.T
        # Vectors (3, 5) of the first bone z, and of the directions y of abduction and u of bending.
        z = np.array([sf * ca, sa, cf * ca])
        y = np.array([-sf * sa, ca, -cf * sa])
        u = st * y
        u[0] += ct * cf
        u[2] -= ct * sf
        s2, c2 = last * s2, last * c2
        across, beyond = middle * s1 + s2, middle * c1 + c2
        along = first + beyond
        tip = along * z + across * u
        J = np.empty((3, 3, 5))
        J[:, 0] = along * y - across * st * z
        J[0, 1], J[1, 1], J[2, 1] = tip[2], 0.0, -tip[0]
        J[:, 2] = (beyond + BEND_RATIO * c2) * u - (across + BEND_RATIO * s2) * z
        return tip.T, J.transpose(2, 0, 1)

    def _angles(self, x: np.ndarray) -> np.ndarray:
        theta = np.empty((5, 4))
        theta[:, :3], theta[:, 3] = x, BEND_RATIO * x[:, 2]
        return theta.ravel()
