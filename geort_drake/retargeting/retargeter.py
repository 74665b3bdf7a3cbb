"""The trained map from human fingertips to robot joints, in NumPy alone.

retarget = load_retargeter("runs/allegro_right")
q = retarget(p_HF)
"""

import os
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from geort_drake.errors import CheckpointError, UnknownNameError
from geort_drake.retargeting.checkpoint import load_checkpoint
from geort_drake.retargeting.human_points import HumanPoints


class Stack(NamedTuple):
    """G networks of one shape, a → h → h → n, whose outputs are added up; each reads a of the G·a inputs.

    SiLU between the layers is evaluated as silu(2u) = u + u tanh u, so the weights and biases of layers 0
    and 1 are half of those trained.
    """

    weight0: np.ndarray  # (G, a, h)
    bias0: np.ndarray  # (G, h)
    weight1: np.ndarray  # (G, h, h)
    bias1: np.ndarray  # (G, h)
    weight2: np.ndarray  # (G, h, n), n joints in the order of q
    bias2: np.ndarray  # (n,)


class Retargeter:
    """Independent per-finger networks, 3 → hidden → hidden → joints, evaluated as one of 3F → H → H → n.

    Stateless and safe to share between threads; what it returns belongs to the caller.

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
        self._stacks = self._read(arrays)
        # What the stacks have in common, as one layer: a product costs more to call than to compute.
        self._weight0 = _aligned(np.hstack([_block_diagonal(s.weight0) for s in self._stacks]))
        self._bias0 = np.concatenate([s.bias0.ravel() for s in self._stacks])
        self._bias1 = np.concatenate([s.bias1.ravel() for s in self._stacks])
        self._weight2 = _aligned(np.vstack([np.vstack(list(s.weight2)) for s in self._stacks]))
        self._bias2 = sum(s.bias2 for s in self._stacks)
        ends = np.cumsum([0, *(s.bias0.size for s in self._stacks)])
        self._layer1 = [
            (slice(start, end), len(s.weight1), s.weight1)
            for start, end, s in zip(ends[:-1].tolist(), ends[1:].tolist(), self._stacks, strict=True)
        ]
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
        x = p_HF.reshape(-1) if p_HF.ndim == 2 else p_HF.reshape(len(p_HF), -1)
        u = x.dot(self._weight0)
        u += self._bias0
        u = self._between(_silu(u))
        q = _silu(u).dot(self._weight2)
        q += self._bias2
        np.tanh(q, q)
        q *= self._half_range
        q += self._centre
        return q

    def value_and_jacobian(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Joint angles q and ∂q/∂p_HF of one hand, at the cost of the Jacobian alone.

        Args:
            points: fingertips p_HF (F, 3) or a whole hand p_HK (21, 3), in the wrist frame H, m.

        Returns:
            q (n,) in rad, as the call gives it, and J (n, F, 3) in rad/m: J[j, f] is the gradient of joint
            j with respect to fingertip f. Keypoints that are no fingertips have no influence.

        Raises:
            ValueError: points have another shape, or are several hands.
            GeortError: a coordinate is not finite.
        """
        p_HF = self._fingertips(points)
        if p_HF.ndim != 2:
            raise ValueError(f"jacobian takes one hand, ({len(self.finger_names)}, 3), not {p_HF.shape}")
        x = p_HF.reshape(-1)
        u = x.dot(self._weight0)
        u += self._bias0
        h, slope0 = _silu_and_slope(u)
        h, slope1 = _silu_and_slope(self._between(h))
        y = h.dot(self._weight2)
        y += self._bias2
        np.tanh(y, y)
        J = np.zeros((x.size, y.size))
        for (units, count, weight1), stack in zip(self._layer1, self._stacks, strict=True):
            # Forward through the layers, because a network has fewer inputs than the hand has joints.
            chain = (stack.weight0 * slope0[units].reshape(count, 1, -1)) @ weight1
            chain *= slope1[units].reshape(count, 1, -1)
            J += (chain @ stack.weight2).reshape(J.shape)
        J *= self._half_range - self._half_range * y * y
        y *= self._half_range
        y += self._centre
        return y, J.T.reshape(y.size, *p_HF.shape)

    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """∂q/∂p_HF (n, F, 3) in rad/m of one hand (F, 3) or (21, 3); see `value_and_jacobian`."""
        return self.value_and_jacobian(points)[1]

    def _read(self, arrays: Mapping[str, np.ndarray]) -> list[Stack]:
        """The networks that `arrays` describe, checked."""
        fingers = len(self.finger_names)
        hidden = _array(arrays, "weight0", (fingers, 3, -1)).shape[2]
        _array(arrays, "bias0", (fingers, 1, hidden))
        _array(arrays, "weight1", (fingers, hidden, hidden))
        _array(arrays, "bias1", (fingers, 1, hidden))
        k = _array(arrays, "weight2", (fingers, hidden, -1)).shape[2]
        _array(arrays, "bias2", (fingers, 1, k))
        columns = self._columns(arrays, fingers * k)
        weight2 = _block_diagonal(arrays["weight2"])[:, columns].reshape(fingers, hidden, -1)
        return [
            Stack(
                0.5 * arrays["weight0"], 0.5 * arrays["bias0"][:, 0],
                _aligned(0.5 * arrays["weight1"]), 0.5 * arrays["bias1"][:, 0],
                weight2, arrays["bias2"].ravel()[columns],
            )
        ]  # fmt: skip

    def _columns(self, arrays: Mapping[str, np.ndarray], outputs: int) -> np.ndarray:
        """Which of the networks' outputs are the joints of q, (n,)."""
        joints = len(self.joint_names)
        columns = _array(arrays, "columns", (joints,))
        if len(set(columns.tolist())) != joints or not (0 <= columns.min() and columns.max() < outputs):
            raise CheckpointError(f"weights: columns must be {joints} different numbers below {outputs}")
        return columns

    def _between(self, h: np.ndarray) -> np.ndarray:
        """Layer 1, where the networks do not see each other: (H,) → (H,) or (N, H) → (N, H)."""
        u = np.empty(h.shape)
        for units, count, weight in self._layer1:
            if h.ndim == 2:
                networks = (len(h), count, -1)
                into = u[:, units].reshape(networks).swapaxes(0, 1)
                np.matmul(h[:, units].reshape(networks).swapaxes(0, 1), weight, out=into)
            elif count > 1:
                networks = (count, 1, -1)
                np.matmul(h[units].reshape(networks), weight, u[units].reshape(networks))
            else:
                # For one vector and one matrix, dot has less overhead than matmul.
                np.dot(h[units], weight[0], u[units])
        u += self._bias1
        return u


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


def _silu(u: np.ndarray) -> np.ndarray:
    """silu(2u), which overflows nowhere."""
    h = np.tanh(u)
    h *= u
    h += u
    return h


def _silu_and_slope(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """silu(2u) and its derivative with respect to u."""
    s = np.tanh(u)
    s += 1.0
    h = s * u
    slope = 2.0 - s
    slope *= h
    slope += s
    return h, slope


def _block_diagonal(blocks: np.ndarray) -> np.ndarray:
    """(G·a, G·b) of blocks (G, a, b)."""
    count, rows, columns = blocks.shape
    full = np.zeros((count, rows, count, columns))
    full[np.arange(count), :, np.arange(count)] = blocks
    return full.reshape(count * rows, count * columns)


def _aligned(array: np.ndarray) -> np.ndarray:
    """A copy that starts at a cache line, from where products with vectors take a tenth less time."""
    memory = np.empty(array.nbytes + 64, dtype=np.uint8)
    start = -memory.__array_interface__["data"][0] % 64
    copy = memory[start : start + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


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
