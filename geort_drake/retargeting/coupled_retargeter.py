"""The trained map of `geort_coupled` in NumPy alone."""

from collections.abc import Mapping

import numpy as np

from geort_drake.retargeting.retargeter import Retargeter, Stack, _aligned, _array


class CoupledRetargeter(Retargeter):
    """Per-finger networks plus one residual network of all fingertips, added before the tanh.

    Call, attributes and errors are those of `Retargeter`, and so are the arguments, but `arrays` also has
    residual_weight0 (3F, r), residual_bias0 (r,), residual_weight1 (r, r), residual_bias1 (r,),
    residual_weight2 (r, F·k) and residual_bias2 (F·k,). The Jacobian is full, as every joint depends on
    every fingertip.
    """

    def _read(self, arrays: Mapping[str, np.ndarray]) -> list[Stack]:
        fingers = super()._read(arrays)
        inputs, outputs = 3 * len(self.finger_names), arrays["bias2"].size
        width = _array(arrays, "residual_weight0", (inputs, -1)).shape[1]
        shapes = ((inputs, width), (width, width), (width, outputs))
        (w0, b0), (w1, b1), (w2, b2) = (
            (_array(arrays, f"residual_weight{k}", shape), _array(arrays, f"residual_bias{k}", shape[1:]))
            for k, shape in enumerate(shapes)
        )
        columns = self._columns(arrays, outputs)
        half = (0.5 * w0[None], 0.5 * b0[None], _aligned(0.5 * w1[None]), 0.5 * b1[None])
        return [*fingers, Stack(*half, w2[None][:, :, columns], b2[columns])]
