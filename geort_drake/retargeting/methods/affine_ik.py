"""A baseline method: an affine map of each fingertip, followed by inverse kinematics."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from geort_drake.errors import GeortError
from geort_drake.retargeting.human_points import HumanPoints
from geort_drake.retargeting.method import UntrainedMethod
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics

if TYPE_CHECKING:
    from geort_drake.retargeting.training.kinematics import HandKinematics

SAMPLES = 4000  # uniform joint angles, whose fingertips sample the robot's workspace
ITERATIONS = 20  # of the inverse kinematics; further ones move fingertips by less than 1 mm
MAX_STEP = 0.2  # rad, of a joint in one iteration
DAMPING = 2e-2  # m/rad; a joint that moves a fingertip by less is hardly used for it


class AffineIK:
    """Maps the workspace of each human fingertip to that of the robot's.

    p_BF = m_B + s (p_HF − m_H) with the means m of recorded human fingertips and of robot fingertips at
    uniform joint angles, and the ratio s of their root mean square distances from these means. The axes of H
    and B are parallel. Damped least squares (Wampler 1986) from the middle of the joint ranges give the joint
    angles, so each result depends only on the given hand.

    Attributes:
        finger_names: F fingers, in the order of the inputs.
        joint_names: n joints, in the order of the outputs.
        lower, upper: (n,) joint limits, rad; outputs are always inside.
        gain: (F, 1) ratios s.
    """

    def __init__(
        self,
        kinematics: "HandKinematics",
        frames: np.ndarray | None,
        seed: int = 0,
        human_keypoints: Sequence[int] | None = None,
    ):
        """Fits the maps to the fingertips `frames` (T, F, 3), m; `seed` draws the robot's joint angles.

        Raises:
            GeortError: there are no frames, a finger hardly moves in them, or a coordinate is not finite.
        """
        self._hand = hand = NumpyKinematics(kinematics)
        self.finger_names, self.joint_names = hand.finger_names, hand.joint_names
        self.lower, self.upper = hand.lower, hand.upper
        self._points = HumanPoints(self.finger_names, human_keypoints)
        p_HF = np.empty((0, 0, 3)) if frames is None else self._points(frames)
        if p_HF.ndim != 3 or len(p_HF) == 0:
            raise GeortError("affine_ik needs recorded frames (T, F, 3) to find the human workspace")
        q = np.random.default_rng(seed).uniform(self.lower, self.upper, (SAMPLES, len(self.lower)))
        self._human, human_spread = _mean_and_spread(p_HF)
        self._robot, robot_spread = _mean_and_spread(hand.fingertips(q))
        if human_spread.min() < 1e-3:
            still = self.finger_names[int(human_spread.argmin())]
            raise GeortError(f"affine_ik needs moving fingertips; the {still} moves less than 1 mm")
        self.gain = (robot_spread / human_spread)[:, None]

    def targets(self, points: np.ndarray) -> np.ndarray:
        """Returns the robot's target fingertips, reachable or not, (F, 3) or (N, F, 3) in B, m."""
        return self._robot + self.gain * (self._points(points) - self._human)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Computes joint angles (n,) or (N, n), rad; `points` are those of `Retargeter`."""
        targets = self.targets(points)
        p_BF = targets.reshape(-1, *targets.shape[-2:])
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
        return q.reshape(*targets.shape[:-2], len(self.joint_names))


def _mean_and_spread(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the means (F, 3) of points (T, F, 3) and the root mean square distances (F,) from them, m."""
    return points.mean(axis=0), np.sqrt(points.var(axis=0).sum(axis=-1))


METHODS = (
    UntrainedMethod(
        "affine_ik",
        "an affine map of each fingertip, and inverse kinematics",
        lambda kinematics, human_keypoints, frames, seed: AffineIK(kinematics, frames, seed, human_keypoints),
    ),
)
