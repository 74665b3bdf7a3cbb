"""A trivial method, which is a lower bound for all others."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from geort_drake.retargeting.human_points import HumanPoints
from geort_drake.retargeting.method import UntrainedMethod
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics

if TYPE_CHECKING:
    from geort_drake.retargeting.training.kinematics import HandKinematics


class Hold:
    """Keeps the joints in the middle of their ranges."""

    def __init__(self, kinematics: "HandKinematics", human_keypoints: Sequence[int] | None = None):
        hand = NumpyKinematics(kinematics)
        self.finger_names, self.joint_names = hand.finger_names, hand.joint_names
        self.lower, self.upper = hand.lower, hand.upper
        self._points = HumanPoints(self.finger_names, human_keypoints)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Returns joint angles (n,) or (N, n), rad; `points` are those of `VectorOnline`."""
        batch = self._points(points).shape[:-2]
        return np.broadcast_to(0.5 * (self.lower + self.upper), (*batch, len(self.joint_names))).copy()


METHODS = (
    UntrainedMethod(
        "hold",
        "a constant posture",
        lambda kinematics, human_keypoints, _frames, _seed: Hold(kinematics, human_keypoints),
    ),
)
