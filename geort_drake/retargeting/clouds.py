"""Point clouds of fingertips, thinned so that repeated visits to a place do not count."""

import numpy as np

TRAINED_VOXEL = 0.006  # m; edge of the voxels that thin `Retargeter.trained_points`


def first_in_voxels(points: np.ndarray, size: float) -> np.ndarray:
    """Returns the rows (M,) of the points (N, 3) that are first in their voxel of edge `size`, by voxel."""
    cells = np.floor(np.asarray(points) / size).astype(np.int64)  # voxel 0 starts at the origin
    cells -= cells.min(axis=0, initial=0)
    # Numbers of the cells in their bounding box are several times faster than `np.unique` along an axis.
    numbers = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0, initial=0) + 1))
    return np.unique(numbers, return_index=True)[1]


def voxel_thinned(points: np.ndarray, size: float) -> np.ndarray:
    """Returns the first of the points (N, 3) in each voxel of edge `size` that contains any: (M, 3)."""
    return np.asarray(points)[np.sort(first_in_voxels(points, size))]


def trained_points(p_HF: np.ndarray) -> np.ndarray:
    """Thins the fingertips (T, F, 3), m, of a recording for `Retargeter.trained_points`.

    Returns:
        (F, M, 3) float32 positions, m; a finger with fewer than M repeats its last one.
    """
    clouds = [voxel_thinned(p_HF[:, i], TRAINED_VOXEL) for i in range(p_HF.shape[1])]
    most = max(map(len, clouds))
    rows = [np.minimum(np.arange(most), len(cloud) - 1) for cloud in clouds]
    return np.stack([cloud[row] for cloud, row in zip(clouds, rows, strict=True)]).astype(np.float32)
