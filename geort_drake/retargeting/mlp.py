"""The trained map in NumPy: a network per finger, and optionally one that sees all fingertips."""

from collections.abc import Mapping

import numpy as np

from geort_drake.errors import MapError
from geort_drake.hands.kinematics import HandKinematics
from geort_drake.retargeting.base import Retargeter, require_arrays, shape_of

# Axes of the arrays in files, see `require_arrays`: F fingers with h hidden units and k outputs each, and a
# residual of r hidden units. `columns` has the numbers of n joints among the F·k outputs.
FINGERS = {
    "weight0": "F 3 h", "weight1": "F h h", "weight2": "F h k",
    "bias0": "F 1 h", "bias1": "F 1 h", "bias2": "F 1 k",
}  # fmt: skip
RESIDUAL = {
    "residual_weight0": "inputs r", "residual_weight1": "r r", "residual_weight2": "r outputs",
    "residual_bias0": "r", "residual_bias1": "r", "residual_bias2": "outputs",
}  # fmt: skip


def output_columns(kinematics: HandKinematics) -> list[int]:
    """Returns the number of each joint among the F·k outputs, some of which shorter fingers do not use."""
    k = max(len(finger.joint_names) for finger in kinematics.fingers)
    columns = [0] * len(kinematics.joint_names)
    for row, finger in enumerate(kinematics.fingers):
        for i, joint in enumerate(finger.joint_indices):
            columns[joint] = row * k + i
    return columns


class MlpRetargeter(Retargeter):
    """q = centre + half range · tanh(f_i(x_i) + r(x_1, …, x_F)), with networks of two hidden SiLU layers.

    f_i sees the fingertip of finger i, and r, which may be absent, sees all. Stateless and thread-safe. The
    weights are `FINGERS`, `columns` and `RESIDUAL`.
    """

    kind = "mlp"

    def _prepare(self, arrays: Mapping[str, np.ndarray]) -> None:
        sizes = {"F": len(self.finger_names), "n": len(self.joint_names)}
        w = require_arrays(arrays, FINGERS | {"columns": "n"}, sizes)
        outputs, columns = w["bias2"].size, w["columns"].astype(int)
        if len(set(columns)) != len(columns) or not (columns.min() >= 0 and columns.max() < outputs):
            raise MapError(f"weights: columns must be different numbers below {outputs}, not {columns}")
        sizes = {"inputs": 3 * sizes["F"], "outputs": outputs}
        if "residual_weight0" in arrays:
            w |= require_arrays(arrays, RESIDUAL, sizes)
        else:
            w |= {name: np.zeros(shape_of(axes, sizes | {"r": 0})) for name, axes in RESIDUAL.items()}
        # Layers 0 and 2 of all networks are one matrix each; in layer 1 that would be mostly zeros.
        self._weight0 = np.hstack([_block_diagonal(w["weight0"]), w["residual_weight0"]])
        self._bias0 = np.concatenate([w["bias0"].ravel(), w["residual_bias0"]])
        self._weight1, self._residual1 = w["weight1"], w["residual_weight1"]
        self._bias1 = np.concatenate([w["bias1"].ravel(), w["residual_bias1"]])
        weight2 = np.vstack([_block_diagonal(w["weight2"]), w["residual_weight2"]])
        self._weight2 = weight2[:, columns]
        self._bias2 = (w["bias2"].ravel() + w["residual_bias2"])[columns]
        self._centre = 0.5 * (self.lower + self.upper)
        # Rounding must not move a saturated output beyond its limit.
        self._half_range = 0.5 * (self.upper - self.lower) * (1.0 - 1e-12)

    def _angles(self, p_HF: np.ndarray) -> np.ndarray:
        h = _silu(p_HF.reshape(len(p_HF), len(self._weight0)) @ self._weight0 + self._bias0)
        h = _silu(self._layer1(h) + self._bias1)
        return self._centre + self._half_range * np.tanh(h @ self._weight2 + self._bias2)

    def _layer1(self, h: np.ndarray) -> np.ndarray:
        """Multiplies rows h (N, H) by the block-diagonal weights of layer 1."""
        F, width = self._weight1.shape[:2]
        fingers = h[:, : F * width].reshape(-1, F, width).swapaxes(0, 1) @ self._weight1
        return np.hstack(
            [fingers.swapaxes(0, 1).reshape(len(h), F * width), h[:, F * width :] @ self._residual1]
        )


def _silu(u: np.ndarray) -> np.ndarray:
    """Computes u / (1 + exp(−u)), by a tanh that never overflows."""
    half = 0.5 * u
    return half + half * np.tanh(half)


def _block_diagonal(blocks: np.ndarray) -> np.ndarray:
    """Returns the block-diagonal matrix (F·a, F·b) of blocks (F, a, b)."""
    F, a, b = blocks.shape
    full = np.zeros((F, a, F, b))
    full[np.arange(F), :, np.arange(F)] = blocks
    return full.reshape(F * a, F * b)
