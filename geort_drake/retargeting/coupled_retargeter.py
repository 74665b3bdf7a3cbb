"""The trained map of `geort_coupled` in NumPy alone."""

from collections.abc import Mapping, Sequence

import numpy as np

from geort_drake.retargeting.retargeter import Retargeter, _array, _silu, _silu_slope


class CoupledRetargeter(Retargeter):
    """Per-finger networks plus one residual network of all fingertips, added before the tanh.

    Call, attributes and errors are those of `Retargeter`; the Jacobian is full, as every joint depends
    on every fingertip.
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
            arrays: those of `Retargeter`, and residual_weight0 (3F, r), residual_bias0 (r,),
                residual_weight1 (r, r), residual_bias1 (r,), residual_weight2 (r, F·k),
                residual_bias2 (F·k,).
            finger_names, joint_names, human_keypoints, lower, upper: as in `Retargeter`.

        Raises:
            CheckpointError: an array is missing, of a wrong shape or not finite.
        """
        super().__init__(arrays, finger_names, joint_names, human_keypoints, lower, upper)
        fingers, outputs = len(self.finger_names), len(self.finger_names) * self._w2.shape[2]
        width = _array(arrays, "residual_weight0", (3 * fingers, -1)).shape[1]
        shapes = ((3 * fingers, width), (width, width), (width, outputs))
        self._residual = [
            (_array(arrays, f"residual_weight{k}", shape), _array(arrays, f"residual_bias{k}", shape[1:]))
            for k, shape in enumerate(shapes)
        ]

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Joint angles in rad, (n,) or (N, n), for human hands; see `Retargeter.__call__`."""
        p_HF = self._fingertips(points)
        hands = p_HF if p_HF.ndim == 3 else p_HF[None]
        y = np.tanh(self._own(hands)[-1] + self._residuals(hands)[-1])
        if not self._in_order:
            y = y[:, self._columns]
        q = self._centre + self._half_range * y
        return q if p_HF.ndim == 3 else q[0]

    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """∂q/∂p_HF of one hand (F, 3) or (21, 3): (n, F, 3) in rad/m."""
        p_HF = self._fingertips(points)
        if p_HF.ndim != 2:
            raise ValueError(f"jacobian takes one hand, ({len(self.finger_names)}, 3), not {p_HF.shape}")
        a0, a1, own = self._own(p_HF[None])
        b0, b1, residual = self._residuals(p_HF[None])
        chain = self._w0 * _silu_slope(a0)
        chain = ((chain @ self._w1) * _silu_slope(a1)) @ self._w2  # (F, 3, k)
        (w0, _), (w1, _), (w2, _) = self._residual
        full = (((w0 * _silu_slope(b0)) @ w1) * _silu_slope(b1)) @ w2  # (3F, F·k)
        fingers, _, k = chain.shape
        full = full.reshape(fingers, 3, fingers, k)
        rows = np.arange(fingers)
        full[rows, :, rows] += chain
        slope = 1.0 - np.tanh(own + residual)[0] ** 2
        full = full.transpose(2, 3, 0, 1).reshape(fingers * k, fingers, 3) * slope[:, None, None]
        return self._half_range[:, None, None] * full[self._columns]

    def _own(self, hands: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Activations' inputs (F, N, ·) of the fingers' networks, and their outputs as (N, F·k)."""
        a0, a1, y = self._outputs(hands.transpose(1, 0, 2))
        return a0, a1, y.transpose(1, 0, 2).reshape(len(hands), -1)

    def _residuals(self, hands: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Activations' inputs (N, r) of the residual network, and its outputs (N, F·k)."""
        (w0, b0), (w1, b1), (w2, b2) = self._residual
        a0 = hands.reshape(len(hands), -1) @ w0 + b0
        a1 = _silu(a0) @ w1 + b1
        return a0, a1, _silu(a1) @ w2 + b2
