"""The space of human fingertips in a map's training, and the distance of a hand from it."""

from collections.abc import Sequence

import numpy as np

from geort_drake.errors import CheckpointError
from geort_drake.people.keypoints import KEYPOINT_COUNT
from geort_drake.retargeting.clouds import voxel_thinned

VOXEL = 0.006  # m; edge of the voxels that thin the points


class TrainedSpace:
    """The thinned positions of each fingertip in the training recording.

    A fingertip far from all of its positions is outside of the training data. The converse does not hold:
    fingertips near recorded positions may form a hand that was never recorded.

    Attributes:
        points: (F, M, 3) float32 positions p_HF, m; a finger with fewer than M repeats its last one.
    """

    def __init__(self, points: np.ndarray, human_keypoints: Sequence[int]):
        """Takes the result of `trained_points`, and the keypoint (0 to 20) of each finger.

        Raises:
            CheckpointError: the points have a wrong shape or are not finite.
        """
        points = np.asarray(points, dtype=np.float32)
        if (
            points.ndim != 3
            or points.shape[0] != len(human_keypoints)
            or points.shape[1] == 0
            or points.shape[2] != 3
            or not np.isfinite(points).all()
        ):
            raise CheckpointError(
                f"trained points must be finite and of shape ({len(human_keypoints)}, M, 3), they have "
                f"{points.shape}"
            )
        self.points = points
        self._keypoints = np.array(human_keypoints, dtype=int)
        # |p − c|² = |p|² + (|c|² − 2 c · p), one product for all positions c.
        positions = points.astype(float).transpose(0, 2, 1)
        forms = np.concatenate([-2.0 * positions, np.square(positions).sum(axis=1, keepdims=True)], axis=1)
        self._forms = np.ascontiguousarray(forms)

    def distances(self, p_HK: np.ndarray) -> np.ndarray:
        """Computes distances (F,), m, of the fingertips of a hand (21, 3) or (F, 3) to the nearest positions.

        Thinning adds at most `VOXEL` · √3, and 2 mm on average.
        """
        p_HF = p_HK.take(self._keypoints, axis=0) if len(p_HK) == KEYPOINT_COUNT else p_HK
        p = np.ones((len(p_HF), 1, 4))
        p[:, 0, :3] = p_HF
        nearest = (p @ self._forms)[:, 0].min(axis=1)
        return np.sqrt(np.maximum(nearest + np.square(p_HF).sum(axis=1), 0.0))


def trained_points(p_HF: np.ndarray) -> np.ndarray:
    """Makes the array (F, M, 3), m, of a `TrainedSpace` from the training's fingertips (T, F, 3), m."""
    clouds = [voxel_thinned(p_HF[:, i], VOXEL) for i in range(p_HF.shape[1])]
    most = max(map(len, clouds))
    return np.stack(
        [np.concatenate([cloud, np.repeat(cloud[-1:], most - len(cloud), axis=0)]) for cloud in clouds]
    ).astype(np.float32)
