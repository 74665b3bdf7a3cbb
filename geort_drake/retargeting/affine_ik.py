"""Baselines: an affine map of each fingertip followed by inverse kinematics, and a constant posture."""

from typing import Any

import numpy as np

from geort_drake.errors import GeortError
from geort_drake.retargeting.base import Retargeter, interface_of, kinematics_of
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics

SAMPLES = 4000  # uniform joint angles, whose fingertips sample the robot's workspace
ITERATIONS = 20  # of the inverse kinematics; further ones move fingertips by less than 1 mm
MAX_STEP = 0.2  # rad, of a joint in one iteration
DAMPING = 2e-2  # m/rad; a joint that moves a fingertip by less is hardly used for it


class AffineIK(Retargeter):
    """Maps the workspace of each human fingertip to that of the robot's.

    p_BF = m_B + s (p_HF − m_H) with the means m of recorded human fingertips and of robot fingertips at
    uniform joint angles, and the ratio s of their root mean square distances from these means. The axes of H
    and B are parallel. Damped least squares (Wampler 1986) from the middle of the joint ranges give the joint
    angles, so each result depends only on the given hand.

    Attributes:
        gain: (F, 1) ratios s.
    """

    def __init__(self, hand: Any, p_HF: np.ndarray | None = None, seed: int = 0, **_options: Any):
        """Fits the maps to fingertips p_HF; `seed` draws the robot's joint angles. See `Method.fit`.

        Raises:
            GeortError: there are no frames, a finger hardly moves in them, or a coordinate is not finite.
        """
        super().__init__(*interface_of(hand))
        self._hand = NumpyKinematics(kinematics_of(hand))
        p_HF = np.empty((0, 0, 3)) if p_HF is None else self.fingertips(p_HF)
        if p_HF.ndim != 3 or len(p_HF) == 0:
            raise GeortError("affine_ik needs recorded frames (T, F, 3) to find the human workspace")
        q = np.random.default_rng(seed).uniform(self.lower, self.upper, (SAMPLES, len(self.lower)))
        self._human, human_spread = _mean_and_spread(p_HF)
        self._robot, robot_spread = _mean_and_spread(self._hand.fingertips(q))
        if human_spread.min() < 1e-3:
            still = self.finger_names[int(human_spread.argmin())]
            raise GeortError(f"affine_ik needs moving fingertips; the {still} moves less than 1 mm")
        self.gain = (robot_spread / human_spread)[:, None]

    def targets(self, points: np.ndarray) -> np.ndarray:
        """Returns the robot's target fingertips, reachable or not, (F, 3) or (N, F, 3) in B, m."""
        return self._robot + self.gain * (self.fingertips(points) - self._human)

    def _angles(self, p_HF: np.ndarray) -> np.ndarray:
        p_BF = self._robot + self.gain * (p_HF - self._human)
        q = np.tile(0.5 * (self.lower + self.upper), (len(p_BF), 1))
        damping = DAMPING**2 * np.eye(3)
        for _ in range(ITERATIONS):
            tips, J = self._hand.fingertips_and_jacobians(q)
            JJ = J @ J.swapaxes(-1, -2) + damping
            weights = np.linalg.solve(JJ, (p_BF - tips)[..., None])
            step = (J.swapaxes(-1, -2) @ weights)[..., 0].sum(axis=1)
            # Faster than np.clip for a single hand.
            step = np.minimum(np.maximum(step, -MAX_STEP), MAX_STEP)
            q = np.minimum(np.maximum(q + step, self.lower), self.upper)
        return q


class Hold(Retargeter):
    """Keeps the joints in the middle of their ranges."""

    def __init__(self, hand: Any, p_HF: np.ndarray | None = None, **_options: Any):
        """See `Method.fit`."""
        super().__init__(*interface_of(hand))

    def _angles(self, p_HF: np.ndarray) -> np.ndarray:
        return np.tile(0.5 * (self.lower + self.upper), (len(p_HF), 1))


def _mean_and_spread(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the means (F, 3) of points (T, F, 3) and the root mean square distances (F,) from them, m."""
    return points.mean(axis=0), np.sqrt(points.var(axis=0).sum(axis=-1))
