"""Rotations about axes."""

import numpy as np


def cross_matrices(axes: np.ndarray) -> np.ndarray:
    """Returns K (..., 3, 3) of axes a (..., 3) such that K x = a × x."""
    K = np.zeros((*axes.shape, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -axes[..., 2], axes[..., 1], -axes[..., 0]
    return K - np.swapaxes(K, -1, -2)
