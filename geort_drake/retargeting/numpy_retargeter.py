"""A trained map with independent fingers, in NumPy."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from geort_drake.errors import CheckpointError, GeortError
from geort_drake.retargeting.aligned import aligned
from geort_drake.retargeting.human_points import HumanPoints
from geort_drake.retargeting.numpy_kinematics import MAX_ANGLE
from geort_drake.retargeting.trained_space import TrainedSpace

# Trained weights stay below 100; products of much larger ones may overflow.
_MAX_WEIGHT = 1e6


class Retargeter:
    """Maps human fingertips to robot joint angles with a trained network; needs only NumPy.

    The per-finger networks, 3 → hidden → hidden → joints, are evaluated as a single one, 3F → H → H → n.

    Stateless and thread-safe; returned arrays belong to the caller.

    Attributes:
        finger_names: F fingers, in the order of the inputs.
        joint_names: n joints, in the order of the outputs.
        human_keypoints: F keypoints that are the human fingertips.
        lower, upper: (n,) joint limits, rad; outputs are always inside.
        trained_space: fingertip positions seen in training; None in checkpoints of version 0.1.
        robot_hands: names of the robot hands for which the map was trained; empty if unknown.
        backend: "numpy", or "numba" after `compile`.
    """

    backend = "numpy"
    trained_space: TrainedSpace | None = None
    robot_hands: tuple[str, ...] = ()
    # Layer 1 of a residual network of all fingers (r, r); empty here.
    _residual_weight1 = np.zeros((0, 0))
    _one_hand: Callable[[np.ndarray], np.ndarray | None] | None = None

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
                weight2 (F, h, k), bias2 (F, 1, k); columns (n,), the number of joint j among the F·k outputs.
            finger_names: F names.
            joint_names: n names.
            human_keypoints: F numbers of the keypoints that are the human fingertips.
            lower, upper: (n,) joint limits, rad.

        Raises:
            CheckpointError: an array is missing, has a wrong shape, is not finite or exceeds ±1e6; or a joint
                limit is not finite or exceeds ±100 rad.
        """
        self.finger_names, self.joint_names = tuple(finger_names), tuple(joint_names)
        self.human_keypoints = tuple(human_keypoints)
        self.lower, self.upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
        for name, limits in (("lower", self.lower), ("upper", self.upper)):
            if not (np.abs(limits) <= MAX_ANGLE).all():
                raise CheckpointError(f"{name} must be finite and within ±{MAX_ANGLE:g} rad, it is {limits}")
        self._fingertips = HumanPoints(finger_names, human_keypoints)
        self._centre = 0.5 * (self.lower + self.upper)
        # Rounding must not move a saturated output beyond its limit.
        self._half_range = 0.5 * (self.upper - self.lower) * (1.0 - 1e-12)
        self._set_weights(arrays)

    def _set_weights(self, arrays: Mapping[str, np.ndarray]) -> None:
        fingers = len(self.finger_names)
        hidden = checked_array(arrays, "weight0", (fingers, 3, -1)).shape[2]
        outputs = fingers * checked_array(arrays, "weight2", (fingers, hidden, -1)).shape[2]
        self._columns = checked_array(arrays, "columns", (len(self.joint_names),))
        if (
            self._columns.dtype.kind not in "iu"
            or len(set(self._columns.tolist())) != self._columns.size
            or not (0 <= self._columns.min() and self._columns.max() < outputs)
        ):
            raise CheckpointError(
                f"weights: columns must be {self._columns.size} different numbers below {outputs}"
            )
        # Layers 0 and 2 of all fingers are one block-diagonal matrix each, which is faster than a stack of
        # products; layer 1 would have too many zeros. Layers 0 and 1 are halved for `_silu`.
        self._own, self._finger_shape = slice(0, fingers * hidden), (fingers, 1, hidden)
        self._finger_weight0 = 0.5 * arrays["weight0"]
        self._weight0 = aligned(_block_diagonal(self._finger_weight0))
        self._bias0 = 0.5 * checked_array(arrays, "bias0", (fingers, 1, hidden)).ravel()
        self._weight1 = aligned(0.5 * checked_array(arrays, "weight1", (fingers, hidden, hidden)))
        self._bias1 = 0.5 * checked_array(arrays, "bias1", (fingers, 1, hidden)).ravel()
        self._weight2 = aligned(_block_diagonal(arrays["weight2"])[:, self._columns])
        self._bias2 = checked_array(arrays, "bias2", (fingers, 1, outputs // fingers)).ravel()[self._columns]

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Computes joint angles, rad, for one or many human hands.

        Args:
            points: fingertips p_HF (F, 3) or (N, F, 3), or whole hands p_HK (21, 3) or (N, 21, 3),
                in the wrist frame H, m.

        Returns:
            Joint angles (n,) or (N, n), rad.

        Raises:
            ValueError: points have another shape.
            GeortError: a coordinate is not finite.
        """
        if self._one_hand is not None and (compiled := self._one_hand(points)) is not None:
            return compiled
        p_HF = self._fingertips(points)
        x = p_HF.reshape(-1) if p_HF.ndim == 2 else p_HF.reshape(-1, len(self._weight0))
        u = x.dot(self._weight0)
        u += self._bias0
        h = _silu(u)
        self._layer1(h, u)
        u += self._bias1
        q = _silu(u).dot(self._weight2)
        q += self._bias2
        np.tanh(q, q)
        q *= self._half_range
        q += self._centre
        return q

    def compile(self) -> None:
        """Compiles calls for one hand with numba, which halves their time; results agree to 1e-12 rad.

        Raises:
            GeortError: numba is not installed, or finds no writable folder for its cache.
        """
        try:
            from geort_drake.retargeting.compiled import Layers, OneHand
        except (ImportError, RuntimeError) as error:  # RuntimeError: no folder for the cache
            raise GeortError(
                f"the backend 'numba' needs the package numba: pip install numba ({error})"
            ) from error
        layers = Layers(
            bias0=self._bias0,
            bias1=self._bias1,
            weight0=self._weight0,
            own=self._weight1,
            shared=self._residual_weight1,
            weight2=self._weight2,
            bias2=self._bias2,
            half_range=self._half_range,
            centre=self._centre,
        )
        self._one_hand = OneHand(layers, self._fingertips.keypoints.tolist())
        self.backend = "numba"

    def value_and_jacobian(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Computes joint angles q and ∂q/∂p_HF of one hand, in the time of the Jacobian alone.

        Args:
            points: fingertips p_HF (F, 3) or a whole hand p_HK (21, 3), in the wrist frame H, m.

        Returns:
            q (n,), rad, as from a call, and J (n, F, 3), rad/m: J[j, f] is the gradient of joint j with
            respect to fingertip f. Other keypoints have no influence.

        Raises:
            ValueError: points have another shape, or are more than one hand.
            GeortError: a coordinate is not finite.
        """
        p_HF = self._fingertips(points)
        if p_HF.ndim != 2:
            raise ValueError(f"jacobian takes one hand, ({len(self.finger_names)}, 3), not {p_HF.shape}")
        x = p_HF.reshape(-1)
        u = x.dot(self._weight0)
        u += self._bias0
        h, slope0 = _silu_and_slope(u)
        self._layer1(h, u)
        u += self._bias1
        h, slope1 = _silu_and_slope(u)
        y = h.dot(self._weight2)
        y += self._bias2
        np.tanh(y, y)
        J = self._gradient(slope0, slope1)
        J *= self._half_range - self._half_range * y * y
        y *= self._half_range
        y += self._centre
        return y, J.T.reshape(y.size, *p_HF.shape)

    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """Computes ∂q/∂p_HF (n, F, 3), rad/m, of one hand (F, 3) or (21, 3); see `value_and_jacobian`."""
        return self.value_and_jacobian(points)[1]

    def _layer1(self, h: np.ndarray, u: np.ndarray) -> None:
        """Writes layer 1 of h (H,) or (N, H), without its bias, into u of the same shape."""
        if h.ndim == 1:
            np.matmul(
                h[self._own].reshape(self._finger_shape),
                self._weight1,
                u[self._own].reshape(self._finger_shape),
            )
        else:
            shape = (-1, len(self._weight1), self._weight1.shape[1])
            out = u[:, self._own].reshape(shape).swapaxes(0, 1)
            np.matmul(h[:, self._own].reshape(shape).swapaxes(0, 1), self._weight1, out=out)

    def _gradient(self, slope0: np.ndarray, slope1: np.ndarray) -> np.ndarray:
        """Returns the derivative (3F, n) of the input of the tanh, given the activations' slopes (H,)."""
        # Forward mode, because a finger has fewer coordinates than joints.
        chain = (self._finger_weight0 * slope0[self._own].reshape(self._finger_shape)) @ self._weight1
        chain *= slope1[self._own].reshape(self._finger_shape)
        weight2 = self._weight2[self._own].reshape(*self._weight1.shape[:2], -1)
        return (chain @ weight2).reshape(len(self._weight0), -1)


def _silu(u: np.ndarray) -> np.ndarray:
    """Computes silu(2u) = u + u tanh u, which never overflows."""
    h = np.tanh(u)
    h *= u
    h += u
    return h


def _silu_and_slope(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Computes silu(2u) and its derivative with respect to u."""
    s = np.tanh(u)
    s += 1.0
    h = s * u
    slope = 2.0 - s
    slope *= h
    slope += s
    return h, slope


def _block_diagonal(blocks: np.ndarray) -> np.ndarray:
    """Returns the block-diagonal matrix (G·a, G·b) of blocks (G, a, b)."""
    count, rows, columns = blocks.shape
    full = np.zeros((count, rows, count, columns))
    full[np.arange(count), :, np.arange(count)] = blocks
    return full.reshape(count * rows, count * columns)


def checked_array(arrays: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...]) -> np.ndarray:
    """Returns the named array; raises CheckpointError if it is unusable. −1 in `shape` is any size but 0."""
    if name not in arrays:
        raise CheckpointError(f"weights: '{name}' is missing; there are {', '.join(sorted(arrays))}")
    value = arrays[name]
    fits = value.ndim == len(shape) and all(
        expected == given or (expected == -1 and given > 0)
        for expected, given in zip(shape, value.shape, strict=True)
    )
    if not fits or value.dtype.kind not in "fiu" or not np.isfinite(value).all():
        raise CheckpointError(
            f"weights: '{name}' must be finite and of shape {shape}, it has {value.shape} of {value.dtype}"
        )
    farthest = max(float(value.min()), float(value.max()), key=abs)
    if abs(farthest) > _MAX_WEIGHT:
        raise CheckpointError(f"weights: '{name}' must be within ±{_MAX_WEIGHT:g}, it has {farthest:g}")
    return value
