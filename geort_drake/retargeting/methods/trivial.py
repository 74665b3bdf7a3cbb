"""Trivial methods, which are lower bounds for all others."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from geort_drake.errors import GeortError
from geort_drake.retargeting.human_points import HumanPoints
from geort_drake.retargeting.method import UntrainedMethod
from geort_drake.retargeting.methods.online import VectorOnline
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


class NearestNeighbour(Hold):
    """Returns the joint angles of the stored hand with the nearest fingertips.

    The stored hands are frames of a recording, mapped by `VectorOnline` at rest.
    """

    def __init__(
        self,
        kinematics: "HandKinematics",
        frames: np.ndarray | None,
        count: int = 300,
        seed: int = 0,
        human_keypoints: Sequence[int] | None = None,
    ):
        """Stores `count` of the fingertips `frames` (T, F, 3), m, drawn by `seed`.

        Raises:
            GeortError: there are no frames, or a coordinate is not finite.
        """
        from scipy.spatial import cKDTree

        super().__init__(kinematics, human_keypoints)
        frames = np.empty((0, 0, 3)) if frames is None else self._points(frames)
        if frames.ndim != 3 or len(frames) == 0:
            raise GeortError("nearest_neighbour needs recorded frames (T, F, 3) to store")
        rows = np.random.default_rng(seed).permutation(len(frames))[:count]
        stored = frames[np.sort(rows)]
        self._q = VectorOnline(kinematics, human_keypoints=human_keypoints).settle(stored)
        self._tree = cKDTree(stored.reshape(len(stored), -1))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Returns joint angles (n,) or (N, n), rad; `points` are those of `VectorOnline`."""
        p_HF = self._points(points)
        _, nearest = self._tree.query(p_HF.reshape(*p_HF.shape[:-2], -1))
        return self._q[nearest].copy()


METHODS = (
    UntrainedMethod(
        "hold",
        "a constant posture",
        lambda kinematics, human_keypoints, _frames, _seed: Hold(kinematics, human_keypoints),
    ),
    UntrainedMethod(
        "nearest_neighbour",
        "the closest of 300 stored hands",
        lambda kinematics, human_keypoints, frames, seed: NearestNeighbour(
            kinematics, frames, seed=seed, human_keypoints=human_keypoints
        ),
    ),
)
