"""The trained map of `geort_coupled` in NumPy."""

from collections.abc import Mapping

import numpy as np

from geort_drake.retargeting.aligned import aligned
from geort_drake.retargeting.numpy_retargeter import Retargeter, checked_array


class CoupledRetargeter(Retargeter):
    """Per-finger networks plus one residual network of all fingertips, added before the tanh.

    Arguments, call, attributes and errors are those of `Retargeter`; the Jacobian is full, as every joint
    depends on every fingertip. `arrays` also contains residual_weight0 (3F, r), residual_bias0 (r,),
    residual_weight1 (r, r), residual_bias1 (r,), residual_weight2 (r, F·k) and residual_bias2 (F·k,).
    """

    def _set_weights(self, arrays: Mapping[str, np.ndarray]) -> None:
        super()._set_weights(arrays)
        inputs, outputs = 3 * len(self.finger_names), arrays["bias2"].size
        width = checked_array(arrays, "residual_weight0", (inputs, -1)).shape[1]
        shapes = ((inputs, width), (width, width), (width, outputs))
        (w0, b0), (w1, b1), (w2, b2) = (
            (
                checked_array(arrays, f"residual_weight{k}", shape),
                checked_array(arrays, f"residual_bias{k}", shape[1:]),
            )
            for k, shape in enumerate(shapes)
        )
        # The residual's hidden units follow those of the fingers.
        self._shared = slice(self._own.stop, self._own.stop + width)
        self._weight0 = aligned(np.hstack([self._weight0, 0.5 * w0]))
        self._bias0 = np.concatenate([self._bias0, 0.5 * b0])
        self._residual_weight1 = aligned(0.5 * w1)
        self._bias1 = np.concatenate([self._bias1, 0.5 * b1])
        self._weight2 = aligned(np.vstack([self._weight2, w2[:, self._columns]]))
        self._bias2 = self._bias2 + b2[self._columns]

    def _layer1(self, h: np.ndarray, u: np.ndarray) -> None:
        super()._layer1(h, u)
        if h.ndim == 1:
            np.dot(h[self._shared], self._residual_weight1, u[self._shared])
        else:
            np.matmul(h[:, self._shared], self._residual_weight1, out=u[:, self._shared])

    def _gradient(self, slope0: np.ndarray, slope1: np.ndarray) -> np.ndarray:
        chain = (self._weight0[:, self._shared] * slope0[self._shared]).dot(self._residual_weight1)
        chain *= slope1[self._shared]
        return super()._gradient(slope0, slope1) + chain.dot(self._weight2[self._shared])
