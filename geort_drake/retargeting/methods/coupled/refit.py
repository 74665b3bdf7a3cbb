"""Fits a trained map to another person's hand, from about a minute of their motion.

An affine map first takes each of the new person's fingertips to where training saw that fingertip
(`fit_affine`); it is folded into the layers that read the fingertips, so the network stays what it was. For
`geort_coupled` the weights then go down the losses of training for a while (`fine_tune`), which closes the
pinches: one affine map per finger cannot bring two of them together everywhere.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from scipy.spatial import cKDTree

from geort_drake.errors import TrainingError
from geort_drake.people.recording import PINCH_M
from geort_drake.retargeting.clouds import voxel_thinned
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.methods.coupled.training import CoupledConfig, CoupledTraining
from geort_drake.retargeting.trained_space import VOXEL, TrainedSpace
from geort_drake.retargeting.training.collision_geometry import CollisionShapes
from geort_drake.retargeting.training.descent import Report, device_of, one_thread
from geort_drake.retargeting.training.human_data import HumanData
from geort_drake.retargeting.training.kinematics import HandKinematics
from geort_drake.retargeting.training.pretraining import RobotSamples

Arrays = Mapping[str, np.ndarray]
# From weights to better ones, and the losses on the way.
Tune = Callable[[dict[str, np.ndarray]], tuple[dict[str, np.ndarray], list[dict[str, float]]]]

ROUNDS = 20  # of closest points and least squares; more change the maps by less than a millimetre
PINCH_SHARE = 10.0  # weight of a pinch's width against a fingertip's distance from where it should be
SHEAR_SHARE = 3.0  # weight of what an affine map does beyond stretching the axes
PINCH_FRAMES = 2000  # at most so many are used

# Of a descent that starts from a map which nearly fits.
FINE_TUNING = CoupledConfig(steps=600, learning_rate=0.01, averaging=0.98)


@dataclass(frozen=True)
class AffineMaps:
    """x_i = A_i p_HF_i + b_i: from a new person's fingertips to the trained person's.

    Attributes:
        A: (F, 3, 3).
        b: (F, 3), m.
        miss: (F,) mean distance of the mapped fingertips to the nearest place of training, m.
    """

    A: np.ndarray
    b: np.ndarray
    miss: np.ndarray

    def __call__(self, p_HF: np.ndarray) -> np.ndarray:
        """The trained person's fingertips (..., F, 3), m."""
        return np.einsum("fij,...fj->...fi", self.A, p_HF) + self.b


@dataclass(frozen=True)
class Refit:
    """A map for the new person.

    Attributes:
        arrays: the weights, as a checkpoint holds them.
        affine: what the first step found.
        history: losses of the fine-tuning; empty where there was none.
        timings: wall seconds.
    """

    arrays: dict[str, np.ndarray]
    affine: AffineMaps
    history: list[dict[str, float]] = field(default_factory=list)
    timings: dict[str, float] = field(default_factory=dict)


def fit_affine(space: TrainedSpace, p_HF: np.ndarray, finger_names: Sequence[str]) -> AffineMaps:
    """The affine maps of a new person's fingertips onto the places of training.

    Closest points in both directions, alternating with linear least squares in which the pinches of the
    person tie the fingers together: two tips that meet shall meet after the map as well. Fingertips keep
    their directions where that is possible (motion preservation), so shear and rotation are held back.

    Args:
        space: where training saw the fingertips.
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
            for given, wanted in ((mine, theirs[there]), (mine[back], theirs)):
                H = _lifted(given) / np.sqrt(len(given))
                for axis in range(3):
                    own_columns = _columns(i, axis)
                    normal[np.ix_(own_columns, own_columns)] += H.T @ H
                    right[own_columns] += H.T @ wanted[:, axis] / np.sqrt(len(given))
            for axis in range(3):
                others = [k for k in range(3) if k != axis]
                columns = _columns(i, axis)[others]
                normal[columns, columns] += SHEAR_SHARE * mine.var(axis=0)[others]
        theta = np.linalg.solve(normal, right).reshape(theta.shape)
    maps = AffineMaps(theta[..., :3], theta[..., 3], np.zeros(len(own)))
    miss = [
        tree.query(_lifted(mine) @ row.T)[0].mean() for mine, row, tree in zip(own, theta, trees, strict=True)
    ]
    return replace(maps, miss=np.array(miss))


def folded(arrays: Arrays, maps: AffineMaps) -> dict[str, np.ndarray]:
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


def fine_tune(
    arrays: Arrays,
    p_HF: np.ndarray,
    kinematics: HandKinematics,
    samples: RobotSamples,
    shapes: CollisionShapes,
    config: CoupledConfig = FINE_TUNING,
    seed: int = 0,
    device: str = "cpu",
    report: Report | None = None,
) -> tuple[dict[str, np.ndarray], list[dict[str, float]]]:
    """Trains weights of `geort_coupled` further, on another person's hands.

    Args:
        arrays: the weights to start from, of layers as wide as the configuration says.
        p_HF, kinematics, samples, config, seed, device, report, shapes: as in `train_coupled`.

    Returns:
        The weights, and the losses on the way.

    Raises:
        TrainingError: the layers have other widths; see `train_coupled`.
    """
    widths = arrays["weight0"].shape[2], arrays["residual_weight0"].shape[1]
    config = replace(config, hidden=widths[0], residual_hidden=widths[1])
    config.validate()
    with one_thread():
        run = CoupledTraining(p_HF, kinematics, samples, config, seed, device_of(device), shapes)
        _start_from(run.network, arrays)
        result = run.train(report)
    return result.network.arrays(), result.history


def refit(
    arrays: Arrays,
    space: TrainedSpace,
    p_HF: np.ndarray,
    finger_names: Sequence[str],
    tune: Tune | None = None,
) -> Refit:
    """Both steps; `tune` takes the weights after the first and returns what `fine_tune` does."""
    started = time.perf_counter()
    maps = fit_affine(space, p_HF, finger_names)
    weights = folded(arrays, maps)
    timings = {"affine_s": time.perf_counter() - started}
    if tune is None:
        return Refit(weights, maps, timings=timings)
    started = time.perf_counter()
    weights, history = tune(weights)
    return Refit(weights, maps, history, {**timings, "fine_tuning_s": time.perf_counter() - started})


def _start_from(network: CoupledNetwork, arrays: Arrays) -> None:
    """Gives the network the weights that `CoupledNetwork.arrays` would return.

    Raises:
        TrainingError: they are of layers of other shapes.
    """
    for name, own in network.arrays().items():
        if name not in arrays or arrays[name].shape != own.shape:
            given = arrays[name].shape if name in arrays else "missing"
            raise TrainingError(f"weights to start from: {name} must be of shape {own.shape}, it is {given}")
    values = {name: np.asarray(array, dtype=float) for name, array in arrays.items()}
    # The opposite of how `arrays` folds the network's own normalisation into the layers that read.
    mean, scale = network.mean.double().cpu().numpy(), network.scale.double().cpu().numpy()
    W, R = values["weight0"], values["residual_weight0"]
    values["weight0"], values["bias0"] = W * scale.transpose(0, 2, 1), values["bias0"] + mean @ W
    values["residual_weight0"] = R * scale.reshape(-1, 1)
    values["residual_bias0"] = values["residual_bias0"] + mean.reshape(-1) @ R
    with torch.no_grad():
        for prefix, layers in (("", network.mlp), ("residual_", network.residual)):
            for kind, parameters in (("weight", layers.weights), ("bias", layers.biases)):
                for number, parameter in enumerate(parameters):
                    value = values[f"{prefix}{kind}{number}"].reshape(parameter.shape)
                    parameter.copy_(torch.as_tensor(value))


def _pinch_equations(human: HumanData) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of: where two tips pinch, their difference stays what it is."""
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
    weight = PINCH_SHARE / max(len(rows), 1)
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
