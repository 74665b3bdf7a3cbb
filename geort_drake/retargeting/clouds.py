"""Point clouds of fingertips, thinned so that repeated visits to a place do not count.

`TrainedSpace` keeps those of a map's training, and measures how far a hand is from them.
"""

from collections.abc import Sequence

import numpy as np

from geort_drake.errors import MapError
from geort_drake.people.keypoints import KEYPOINT_COUNT

TRAINED_VOXEL = 0.006  # m; edge of the voxels that thin the points of `TrainedSpace`


def voxel_index(points: np.ndarray, size: float) -> np.ndarray:
    """Returns integer voxel coordinates (N, 3) of points (N, 3); voxel 0 starts at the origin."""
    return np.floor(np.asarray(points) / size).astype(np.int64)


def first_in_voxels(points: np.ndarray, size: float) -> np.ndarray:
    """Returns ascending rows (M,) of the points (N, 3) that are the first in their voxel of edge `size`."""
    return np.sort(_first_of_each(voxel_index(points, size)))


def voxel_thinned(points: np.ndarray, size: float) -> np.ndarray:
    """Returns the first of the points (N, 3) in each voxel of edge `size` that contains any: (M, 3)."""
    return np.asarray(points)[first_in_voxels(points, size)]


def voxel_centres(points: np.ndarray, size: float) -> np.ndarray:
    """Returns the centres (M, 3) of the voxels of edge `size` that contain any of the points (N, 3)."""
    cells = voxel_index(points, size)
    return (cells[_first_of_each(cells)] + 0.5) * size


def _first_of_each(cells: np.ndarray) -> np.ndarray:
    """Returns the rows (M,) of the first of each distinct cell (N, 3), sorted by the cells' contents.

    `np.unique` along an axis gives the same rows, but takes several times as long.
    """
    order = np.lexsort(cells.T[::-1])
    new = np.ones(len(cells), dtype=bool)
    new[1:] = (cells[order[1:]] != cells[order[:-1]]).any(axis=1)
    return order[new]


class TrainedSpace:
    """The thinned positions of each fingertip in the training recording.

    A fingertip far from all of its positions is outside of the training data. The converse does not hold:
    fingertips near recorded positions may form a hand that was never recorded.

    Attributes:
        points: (F, M, 3) float32 positions p_HF, m; a finger with fewer than M repeats its last one.
    """

    def __init__(self, points: np.ndarray, human_keypoints: Sequence[int]):
        """Takes positions, and the keypoint of each finger.

        Raises:
            MapError: the positions have a wrong shape or are not finite.
        """
        self.points = np.asarray(points, dtype=np.float32)
        fingers = len(human_keypoints)
        if self.points.shape != (fingers, self.points.size // max(3 * fingers, 1), 3) or not (
            self.points.size and np.isfinite(self.points).all()
        ):
            raise MapError(
                f"trained points must be finite and of shape ({fingers}, M, 3), not {self.points.shape}"
            )
        self._keypoints = np.array(human_keypoints, dtype=int)
        # |p − c|² = |p|² + (|c|² − 2 c · p), one product for all positions c.
        positions = self.points.astype(float).transpose(0, 2, 1)
        self._forms = np.concatenate([-2.0 * positions, np.square(positions).sum(1, keepdims=True)], axis=1)

    @classmethod
    def of_recording(cls, p_HF: np.ndarray, human_keypoints: Sequence[int]) -> "TrainedSpace":
        """Thins the fingertips (T, F, 3), m, of a recording."""
        clouds = [voxel_thinned(p_HF[:, i], TRAINED_VOXEL) for i in range(p_HF.shape[1])]
        most = max(map(len, clouds))
        rows = [np.minimum(np.arange(most), len(cloud) - 1) for cloud in clouds]
        return cls(np.stack([cloud[row] for cloud, row in zip(clouds, rows, strict=True)]), human_keypoints)

    def distances(self, p_HK: np.ndarray) -> np.ndarray:
        """Computes distances (F,), m, of the fingertips of a hand (21, 3) or (F, 3) to the nearest positions.

        Thinning adds at most `TRAINED_VOXEL` · √3, and 2 mm on average.
        """
        p_HF = p_HK.take(self._keypoints, axis=0) if len(p_HK) == KEYPOINT_COUNT else p_HK
        p = np.concatenate([p_HF, np.ones((len(p_HF), 1))], axis=1)[:, None]
        nearest = (p @ self._forms)[:, 0].min(axis=1)
        return np.sqrt(np.maximum(nearest + np.square(p_HF).sum(axis=1), 0.0))
