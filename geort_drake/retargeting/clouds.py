"""Point clouds of fingertips, thinned so that repeated visits to a place do not count."""

import numpy as np


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


def without_repeats(frames: np.ndarray) -> np.ndarray:
    """Returns the frames (T, ...) that do not exactly repeat an earlier one, in order."""
    _, first = np.unique(frames.reshape(len(frames), -1), axis=0, return_index=True)
    return frames[np.sort(first)]
