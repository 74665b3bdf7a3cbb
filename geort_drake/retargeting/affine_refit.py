"""Fits a trained map to another person: one affine map per finger, folded into the weights.

The maps take each of the new person's fingertips to where it was in training.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from geort_drake.people.recording import PINCH_M
from geort_drake.retargeting.clouds import voxel_thinned
from geort_drake.retargeting.trained_space import VOXEL, TrainedSpace
from geort_drake.retargeting.training.human_data import HumanData

ROUNDS = 20  # of closest points and least squares; further ones move points by less than a millimetre
PINCH_WEIGHT = 10.0  # of a pinch's width against a fingertip's distance from its place in training
SHEAR_WEIGHT = 3.0  # of everything but stretching along the axes
PINCH_FRAMES = 2000  # maximum number of frames in the pinch equations


@dataclass(frozen=True)
class AffineMaps:
    """x_i = A_i p_HF_i + b_i: from a new person's fingertips to the trained person's.

    Attributes:
        A: (F, 3, 3).
        b: (F, 3), m.
        miss: (F,) mean distance of the mapped fingertips to the nearest place in training, m.
    """

    A: np.ndarray
    b: np.ndarray
    miss: np.ndarray

    def __call__(self, p_HF: np.ndarray) -> np.ndarray:
        """The trained person's fingertips (..., F, 3), m."""
        return np.einsum("fij,...fj->...fi", self.A, p_HF) + self.b


def fit_affine(space: TrainedSpace, p_HF: np.ndarray, finger_names: Sequence[str]) -> AffineMaps:
    """Fits affine maps of a new person's fingertips onto those of training.

    Closest points in both directions alternate with linear least squares, in which the person's pinches tie
    the fingers together: two tips that meet should also meet after the map. Shear and rotation are penalised,
    because they change the directions of motion.

    Args:
        space: the fingertips' places in training.
        p_HF: (T, F, 3) of the new person, in H, m.
        finger_names: F names.

    Raises:
        TrainingError: the fingertips are not finite, of a wrong shape or hardly move.
    """
    human = HumanData(p_HF, finger_names, VOXEL / 2)
    own = [voxel_thinned(human.frames[:, i], VOXEL) for i in range(len(finger_names))]
    trained = [np.unique(places, axis=0).astype(float) for places in space.points]
    trees = [cKDTree(places) for places in trained]
    ties = _pinch_equations(human)
    # Columns of one axis of one finger: three factors and the offset.
    theta = np.zeros((len(own), 3, 4))
    for i, (mine, theirs) in enumerate(zip(own, trained, strict=True)):
        stretch = theirs.std(axis=0) / np.maximum(mine.std(axis=0), 1e-3)
        theta[i, :, :3] = np.diag(stretch)
        theta[i, :, 3] = theirs.mean(axis=0) - stretch * mine.mean(axis=0)
    for _ in range(ROUNDS):
        normal, right = ties[0].copy(), ties[1].copy()
        for i, (mine, theirs, tree) in enumerate(zip(own, trained, trees, strict=True)):
            x = _lifted(mine) @ theta[i].T
            there, back = tree.query(x)[1], cKDTree(x).query(theirs)[1]
            for given, target in ((mine, theirs[there]), (mine[back], theirs)):
                H = _lifted(given) / np.sqrt(len(given))
                for axis in range(3):
                    own_columns = _columns(i, axis)
                    normal[np.ix_(own_columns, own_columns)] += H.T @ H
                    right[own_columns] += H.T @ target[:, axis] / np.sqrt(len(given))
            for axis in range(3):
                others = [k for k in range(3) if k != axis]
                columns = _columns(i, axis)[others]
                normal[columns, columns] += SHEAR_WEIGHT * mine.var(axis=0)[others]
        theta = np.linalg.solve(normal, right).reshape(theta.shape)
    miss = [
        tree.query(_lifted(mine) @ row.T)[0].mean() for mine, row, tree in zip(own, theta, trees, strict=True)
    ]
    return AffineMaps(theta[..., :3], theta[..., 3], np.array(miss))


def folded(arrays: Mapping[str, np.ndarray], maps: AffineMaps) -> dict[str, np.ndarray]:
    """The weights of the map that first applies `maps`: x W + b = p (Aᵀ W) + (b + offset W)."""
    result = {name: np.array(array) for name, array in arrays.items()}
    W = arrays["weight0"]
    result["bias0"] = arrays["bias0"] + (maps.b[:, None] @ W)
    result["weight0"] = maps.A.transpose(0, 2, 1) @ W
    if "residual_weight0" in arrays:
        W = arrays["residual_weight0"].reshape(*maps.b.shape, -1)
        result["residual_bias0"] = arrays["residual_bias0"] + np.einsum("fi,fih->h", maps.b, W)
        result["residual_weight0"] = (maps.A.transpose(0, 2, 1) @ W).reshape(arrays["residual_weight0"].shape)
    return result


def _pinch_equations(human: HumanData) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations that keep the difference of two tips where they pinch."""
    fingers = len(human.finger_names)
    normal, right = np.zeros((12 * fingers, 12 * fingers)), np.zeros(12 * fingers)
    if not human.pairs:
        return normal, right
    first, second = (list(side) for side in zip(*human.pairs, strict=True))
    difference = human.frames[:, first] - human.frames[:, second]
    distance = np.linalg.norm(difference, axis=-1)
    rows = np.flatnonzero(distance.min(axis=1) < PINCH_M)
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), PINCH_FRAMES)).astype(int)]
    nearest = distance[rows].argmin(axis=1)
    weight = PINCH_WEIGHT / max(len(rows), 1)
    for pair, (a, b) in enumerate(human.pairs):
        some = rows[nearest == pair]
        J = np.hstack([_lifted(human.frames[some, a]), -_lifted(human.frames[some, b])])
        for axis in range(3):
            columns = np.concatenate([_columns(a, axis), _columns(b, axis)])
            normal[np.ix_(columns, columns)] += weight * J.T @ J
            right[columns] += weight * J.T @ difference[some, pair, axis]
    return normal, right


def _lifted(points: np.ndarray) -> np.ndarray:
    """(N, 4) of points (N, 3): with a one for the offset."""
    return np.column_stack([points, np.ones(len(points))])


def _columns(finger: int, axis: int) -> np.ndarray:
    """The four unknowns of one axis of one finger's map."""
    return 12 * finger + 4 * axis + np.arange(4)
