"""Retargeting of a single hand, compiled by numba; see `load_retargeter(path, backend="numba")`."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit, types

from geort_drake.people.keypoints import KEYPOINT_COUNT
from geort_drake.retargeting.aligned import aligned

_LINE = 8  # float64 numbers in a cache line
# Sums may be reordered and fused; infinities and NaN stay exact.
_FASTMATH = {"reassoc", "contract", "arcp", "nsz"}
# Read-only arrays, to which numba converts writable ones.
_POINTS, _PLAN, _WEIGHTS = (
    types.Array(kind, dimensions, "C", readonly=True)
    for kind, dimensions in ((types.float64, 2), (types.int64, 1), (types.float64, 1))
)


class Layers(NamedTuple):
    """Weights of a map of F fingers with H = F·w + r hidden units: w per finger, r of the shared residual.

    q = tanh(silu(2 (silu(2 (x W0 + b0)) W1 + b1)) W2 + b2) · half_range + centre, where W1 has the blocks
    `own` and `shared` on its diagonal.
    """

    bias0: np.ndarray  # (H,)
    bias1: np.ndarray  # (H,)
    weight0: np.ndarray  # (3F, H)
    own: np.ndarray  # (F, w, w)
    shared: np.ndarray  # (r, r)
    weight2: np.ndarray  # (H, n)
    bias2: np.ndarray  # (n,)
    half_range: np.ndarray  # (n,)
    centre: np.ndarray  # (n,)


class OneHand:
    """Evaluates a `Retargeter` for one hand in half the time; results agree to rounding.

    A call returns None for several hands and for unusable input, which the retargeter then handles.
    """

    def __init__(self, layers: Layers, human_keypoints: Sequence[int]):
        if not all(0 <= keypoint < KEYPOINT_COUNT for keypoint in human_keypoints):
            raise ValueError(f"keypoints must be from 0 to {KEYPOINT_COUNT - 1}, not {list(human_keypoints)}")
        fingers, width = layers.own.shape[:2]
        sizes = (width, len(layers.shared), len(layers.bias2))
        self._fingertips = np.array([*sizes, *range(fingers)], dtype=np.int64)
        self._keypoints = np.array([*sizes, *human_keypoints], dtype=np.int64)
        # `_angles` reads the weights in this order.
        parts = layers._replace(weight2=layers.weight2.T)
        self._weights = aligned(np.concatenate([_padded(part) for part in parts]))

    def __call__(self, points: np.ndarray) -> np.ndarray | None:
        """Computes joint angles (n,), rad, of fingertips p_HF (F, 3) or keypoints p_HK (21, 3), m."""
        points = np.ascontiguousarray(points, dtype=float)
        if points.shape == (KEYPOINT_COUNT, 3):
            plan = self._keypoints
        elif points.shape == (len(self._fingertips) - 3, 3):
            plan = self._fingertips
        else:
            return None
        if not points.flags.aligned:
            points = points.copy()
        q = _angles(points, plan, self._weights)
        return q if q.size else None


def _padded(part: np.ndarray) -> np.ndarray:
    return np.pad(part.ravel(), (0, -part.size % _LINE))


@njit(fastmath=_FASTMATH, error_model="numpy", cache=True)
def _add_product(x: np.ndarray, W: np.ndarray, y: np.ndarray) -> None:
    """Adds x W to y, with W flat by rows; takes eight rows at a time to read and write y less often."""
    n = len(y)
    eights = len(x) // 8 * 8
    for i in range(0, eights, 8):
        row0, row1, row2, row3 = W[i * n :], W[(i + 1) * n :], W[(i + 2) * n :], W[(i + 3) * n :]
        row4, row5, row6, row7 = W[(i + 4) * n :], W[(i + 5) * n :], W[(i + 6) * n :], W[(i + 7) * n :]
        for j in range(n):
            y[j] += (
                (x[i] * row0[j] + x[i + 1] * row1[j])
                + (x[i + 2] * row2[j] + x[i + 3] * row3[j])
                + (x[i + 4] * row4[j] + x[i + 5] * row5[j])
                + (x[i + 6] * row6[j] + x[i + 7] * row7[j])
            )
    for i in range(eights, len(x)):
        row0 = W[i * n :]
        for j in range(n):
            y[j] += x[i] * row0[j]


@njit(fastmath=_FASTMATH, error_model="numpy", inline="always")
def _exp(x: float) -> float:
    """Computes exp(x) to 1e-12, with x clipped to ±40, by a series at x/64 that the compiler vectorises."""
    x = x if x < 40.0 else 40.0
    x = x if x > -40.0 else -40.0
    x *= 1.0 / 64.0
    e = 1.0 + x / 12.0
    for k in range(11, 0, -1):
        e = 1.0 + x / k * e
    for _ in range(6):
        e *= e
    return e


@njit(fastmath=_FASTMATH, error_model="numpy", cache=True)
def _silu(u: np.ndarray) -> None:
    """Replaces u by silu(2u) = 2u / (1 + exp(−2u))."""
    for j in range(len(u)):
        u[j] = 2.0 * u[j] / (1.0 + _exp(-2.0 * u[j]))


@njit(fastmath=_FASTMATH, error_model="numpy", cache=True)
def _tanh(y: np.ndarray) -> None:
    """Replaces y by tanh(y) = 2 / (1 + exp(−2y)) − 1."""
    for j in range(len(y)):
        y[j] = 2.0 / (1.0 + _exp(-2.0 * y[j])) - 1.0


@njit(fastmath=_FASTMATH, error_model="numpy", cache=True)
def _add_dots(W: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
    """Adds W x to y, with W flat by rows; takes four rows at a time to read x less often."""
    n = len(x)
    fours = len(y) // 4 * 4
    for i in range(0, fours, 4):
        row0, row1, row2, row3 = W[i * n :], W[(i + 1) * n :], W[(i + 2) * n :], W[(i + 3) * n :]
        sum0 = sum1 = sum2 = sum3 = 0.0
        for j in range(n):
            sum0 += row0[j] * x[j]
            sum1 += row1[j] * x[j]
            sum2 += row2[j] * x[j]
            sum3 += row3[j] * x[j]
        y[i] += sum0
        y[i + 1] += sum1
        y[i + 2] += sum2
        y[i + 3] += sum3
    for i in range(fours, len(y)):
        row0 = W[i * n :]
        for j in range(n):
            y[i] += row0[j] * x[j]


@njit
def _split(weights: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the first `size` numbers, and those from the next cache line on."""
    return weights[:size], weights[(size + _LINE - 1) // _LINE * _LINE :]


@njit(types.float64[::1](_POINTS, _PLAN, _WEIGHTS), fastmath=_FASTMATH, error_model="numpy", cache=True)
def _angles(points: np.ndarray, plan: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Computes joint angles of the fingertips in rows plan[3:] of points; empty if these are not finite."""
    width, shared, joints = plan[0], plan[1], plan[2]
    fingers = len(plan) - 3
    x = np.empty(3 * fingers)
    squares = 0.0
    for finger in range(fingers):
        for axis in range(3):
            value = points[plan[3 + finger], axis]
            x[3 * finger + axis] = value
            squares += value * value
    if not math.isfinite(squares):
        return np.empty(0)
    own = fingers * width
    hidden = own + shared
    bias0, weights = _split(weights, hidden)
    bias1, weights = _split(weights, hidden)
    weight0, weights = _split(weights, len(x) * hidden)
    weight1, weights = _split(weights, fingers * width * width)
    residual, weights = _split(weights, shared * shared)
    weight2, weights = _split(weights, joints * hidden)
    bias2, weights = _split(weights, joints)
    half_range, centre = _split(weights, joints)
    h, u = bias0.copy(), bias1.copy()
    _add_product(x, weight0, h)
    _silu(h)
    for finger in range(fingers):
        units = slice(finger * width, (finger + 1) * width)
        _add_product(h[units], weight1[finger * width * width :], u[units])
    _add_product(h[own:], residual, u[own:])
    _silu(u)
    q = bias2.copy()
    _add_dots(weight2, u, q)
    _tanh(q)
    for j in range(joints):
        q[j] = q[j] * half_range[j] + centre[j]
    return q
