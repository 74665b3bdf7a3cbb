"""The trained map in NumPy: a network per finger, and optionally one that sees all fingertips."""

from collections.abc import Mapping

import numpy as np

from geort_drake.errors import MapError
from geort_drake.retargeting.base import Retargeter, require_arrays, width_of

Shapes = dict[str, tuple[int, ...]]  # of the arrays in files


def finger_shapes(arrays: Mapping[str, np.ndarray], F: int, n: int) -> Shapes:
    """Returns the shapes of the networks of F fingers, with h hidden units and k outputs each.

    `columns` has the numbers of n joints among the F·k outputs.
    """
    h, k = width_of(arrays, "weight0"), width_of(arrays, "weight2")
    return {
        "weight0": (F, 3, h),
        "bias0": (F, 1, h),
        "weight1": (F, h, h),
        "bias1": (F, 1, h),
        "weight2": (F, h, k),
        "bias2": (F, 1, k),
        "columns": (n,),
    }


def residual_shapes(inputs: int, r: int, outputs: int) -> Shapes:
    """Returns the shapes of the network of r hidden units that sees all fingertips."""
    return {
        "residual_weight0": (inputs, r),
        "residual_bias0": (r,),
        "residual_weight1": (r, r),
        "residual_bias1": (r,),
        "residual_weight2": (r, outputs),
        "residual_bias2": (outputs,),
    }


class MlpRetargeter(Retargeter):
    """q = centre + half range · tanh(f_i(x_i) + r(x_1, …, x_F)), with networks of two hidden SiLU layers.

    f_i sees the fingertip of finger i, and r, which may be absent, sees all. Stateless and thread-safe. The
    weights have `finger_shapes` and `residual_shapes`.
    """

    kind = "mlp"

    def _prepare(self, arrays: Mapping[str, np.ndarray]) -> None:
        F = len(self.finger_names)
        w = require_arrays(arrays, finger_shapes(arrays, F, len(self.joint_names)))
        outputs, columns = w["bias2"].size, w["columns"].astype(int)
        if len(set(columns)) != len(columns) or not (columns.min() >= 0 and columns.max() < outputs):
            raise MapError(f"weights: columns must be different numbers below {outputs}, not {columns}")
        if "residual_weight0" in arrays:
            w |= require_arrays(arrays, residual_shapes(3 * F, width_of(arrays, "residual_weight0"), outputs))
        else:
            w |= {name: np.zeros(shape) for name, shape in residual_shapes(3 * F, 0, outputs).items()}
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

    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """Computes ∂q/∂p_HF (n, F, 3), rad/m, of one hand (F, 3) or (21, 3), exactly."""
        p_HF = self._one_hand(points)
        u0 = p_HF.reshape(1, -1) @ self._weight0 + self._bias0
        u1 = self._layer1(_silu(u0)) + self._bias1
        y = np.tanh(_silu(u1) @ self._weight2 + self._bias2)
        # Forward mode: a row for each of the 3F coordinates.
        J = self._layer1(self._weight0 * _silu_slope(u0)) * _silu_slope(u1) @ self._weight2
        J *= self._half_range * (1.0 - y * y)
        return J.T.reshape(-1, *p_HF.shape)

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


def _silu_slope(u: np.ndarray) -> np.ndarray:
    s = 0.5 + 0.5 * np.tanh(0.5 * u)
    return s * (1.0 + u * (1.0 - s))


def _block_diagonal(blocks: np.ndarray) -> np.ndarray:
    """Returns the block-diagonal matrix (F·a, F·b) of blocks (F, a, b)."""
    F, a, b = blocks.shape
    full = np.zeros((F, a, F, b))
    full[np.arange(F), :, np.arange(F)] = blocks
    return full.reshape(F * a, F * b)
