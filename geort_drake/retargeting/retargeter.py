"""The trained map from human fingertips to robot joints, in NumPy alone.

retarget = load_retargeter("runs/allegro_right")
q = retarget(p_HF)
"""

import os
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from geort_drake.errors import CheckpointError, UnknownNameError
from geort_drake.retargeting.checkpoint import load_checkpoint
from geort_drake.retargeting.human_points import HumanPoints


class Retargeter:
    """Independent per-finger networks, 3 → hidden → hidden → joints, evaluated as one batch.

    Stateless and safe to share between threads.

    Attributes:
        finger_names: F fingers, in the order of the inputs.
        joint_names: n joints, in the order of the outputs.
        lower, upper: (n,) joint limits, rad; outputs are always inside.
    """

    def __init__(
        self,
        arrays: Mapping[str, np.ndarray],
        finger_names: Sequence[str],
        joint_names: Sequence[str],
        human_keypoints: Sequence[int],
        lower: np.ndarray,
        upper: np.ndarray,
    ):
        """Builds the map from its weights.

        Args:
            arrays: weight0 (F, 3, h), bias0 (F, 1, h), weight1 (F, h, h), bias1 (F, 1, h),
                weight2 (F, h, k), bias2 (F, 1, k); columns (n,), which of the F·k outputs is joint j.
            finger_names: F names.
            joint_names: n names.
            human_keypoints: F numbers of the keypoints that are the human fingertips.
            lower, upper: (n,) joint limits, rad.

        Raises:
            CheckpointError: an array is missing, of a wrong shape or not finite.
        """
        self.finger_names, self.joint_names = tuple(finger_names), tuple(joint_names)
        self.lower, self.upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
        self._fingertips = HumanPoints(finger_names, human_keypoints)
        fingers, joints = len(self.finger_names), len(self.joint_names)
        hidden = _array(arrays, "weight0", (fingers, 3, -1)).shape[2]
        self._w0, self._b0 = arrays["weight0"], _array(arrays, "bias0", (fingers, 1, hidden))
        self._w1 = _array(arrays, "weight1", (fingers, hidden, hidden))
        self._b1 = _array(arrays, "bias1", (fingers, 1, hidden))
        self._w2 = _array(arrays, "weight2", (fingers, hidden, -1))
        self._b2 = _array(arrays, "bias2", (fingers, 1, self._w2.shape[2]))
        self._columns = _array(arrays, "columns", (joints,))
        outputs = fingers * self._w2.shape[2]
        if len(set(self._columns.tolist())) != joints or not (
            0 <= self._columns.min() and self._columns.max() < outputs
        ):
            raise CheckpointError(f"weights: columns must be {joints} different numbers below {outputs}")
        self._in_order = np.array_equal(self._columns, np.arange(outputs))
        self._centre = 0.5 * (self.lower + self.upper)
        # Rounding must not carry a saturated output past its limit.
        self._half_range = 0.5 * (self.upper - self.lower) * (1.0 - 1e-12)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Joint angles in rad for human hands.

        Args:
            points: fingertips p_HF (F, 3) or (N, F, 3), or whole hands p_HK (21, 3) or (N, 21, 3),
                in the wrist frame H, m.

        Returns:
            (n,) or (N, n).

        Raises:
            ValueError: points have another shape.
            GeortError: a coordinate is not finite.
        """
        p_HF = self._fingertips(points)
        if p_HF.ndim == 2:
            y = np.tanh(self._outputs(p_HF[:, None])[-1]).ravel()
        else:
            y = np.tanh(self._outputs(p_HF.transpose(1, 0, 2))[-1]).transpose(1, 0, 2)
            y = y.reshape(len(p_HF), -1)
        if not self._in_order:
            y = y[..., self._columns]
        return self._centre + self._half_range * y

    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """∂q/∂p_HF of one hand (F, 3) or (21, 3): (n, F, 3) in rad/m, zero between fingers."""
        p_HF = self._fingertips(points)
        if p_HF.ndim != 2:
            raise ValueError(f"jacobian takes one hand, ({len(self.finger_names)}, 3), not {p_HF.shape}")
        a0, a1, y = self._outputs(p_HF[:, None])
        chain = self._w0 * _silu_slope(a0)
        chain = (chain @ self._w1) * _silu_slope(a1)
        chain = (chain @ self._w2) * (1.0 - np.tanh(y) ** 2)  # (F, 3, k)
        fingers, _, k = chain.shape
        full = np.zeros((fingers, k, fingers, 3))
        full[np.arange(fingers), :, np.arange(fingers)] = chain.transpose(0, 2, 1)
        rows = full.reshape(fingers * k, fingers, 3)[self._columns]
        return self._half_range[:, None, None] * rows

    def _outputs(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The inputs of the activations, (F, N, ·) each, for fingertips (F, N, 3)."""
        a0 = x @ self._w0 + self._b0
        a1 = _silu(a0) @ self._w1 + self._b1
        return a0, a1, _silu(a1) @ self._w2 + self._b2


def load_retargeter(path: str | os.PathLike, hand=None) -> Retargeter:
    """Loads a checkpoint directory written by training.

    Args:
        path: the directory.
        hand: where given, a hand model (`joint_names`, `finger_names`, `digest`) that the
            checkpoint must have been trained for.

    Raises:
        CheckpointError: a file is missing or altered, or the checkpoint is for another hand.
        UnknownNameError: the checkpoint's method is not known to this version.
    """
    checkpoint = load_checkpoint(path)
    if hand is not None:
        checkpoint.check_hand(hand)
    method = checkpoint.config["method"]
    if method not in METHODS:
        raise UnknownNameError("retargeting method", method, METHODS)
    return METHODS[method](
        checkpoint.arrays,
        checkpoint.config["finger_names"],
        checkpoint.config["joint_names"],
        checkpoint.config["human_keypoints"],
        np.array(checkpoint.hand["lower"]),
        np.array(checkpoint.hand["upper"]),
    )


def _coupled(*arguments) -> Retargeter:
    # Imported here because it builds on this module.
    from geort_drake.retargeting.coupled_retargeter import CoupledRetargeter

    return CoupledRetargeter(*arguments)


# Name in a checkpoint's config.json → what makes the map from its weights, called as `Retargeter` is.
METHODS: dict[str, Callable[..., Retargeter]] = {
    "geort": Retargeter,
    "geort_coupled": _coupled,
    "linear_offline": Retargeter,
}


def _silu(a: np.ndarray) -> np.ndarray:
    return a / (1.0 + np.exp(-np.maximum(a, -500.0)))


def _silu_slope(a: np.ndarray) -> np.ndarray:
    s = 1.0 / (1.0 + np.exp(-np.maximum(a, -500.0)))
    return s * (1.0 + a * (1.0 - s))


def _array(arrays: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...]) -> np.ndarray:
    """The named array, checked; −1 in `shape` stands for any size."""
    if name not in arrays:
        raise CheckpointError(f"weights: '{name}' is missing; there are {', '.join(sorted(arrays))}")
    value = arrays[name]
    fits = value.ndim == len(shape) and all(
        wanted in (-1, given) for wanted, given in zip(shape, value.shape, strict=True)
    )
    if not fits or not np.isfinite(value).all():
        raise CheckpointError(f"weights: '{name}' must be finite and of shape {shape}, it has {value.shape}")
    return value
