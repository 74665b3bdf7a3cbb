"""The One Euro filter: smooths slow motion and follows fast motion.

Source: G. Casiez, N. Roussel, D. Vogel, "1 € Filter: A Simple Speed-based Low-pass Filter for Noisy Input in
Interactive Systems", CHI 2012, https://doi.org/10.1145/2207676.2208639
"""

import math

import numpy as np

_SPEED_CUTOFF_HZ = 1.0  # cutoff of the low-pass on the speed; the paper's value


class OneEuroFilter:
    """Filters points; each point's cutoff grows with its speed.

    Attributes:
        delay: mean delay of slow motion at the cutoffs of the last points, s.

    Args:
        cutoff: cutoff at rest, Hz.
        slope: growth of the cutoff with speed, Hz per m/s.
    """

    def __init__(self, cutoff: float, slope: float):
        self._cutoff, self._slope = cutoff, slope
        self.reset()

    def reset(self) -> None:
        """Forgets all points."""
        self.delay = 0.0
        self._time: float | None = None

    def __call__(self, time: float, p: np.ndarray) -> np.ndarray:
        """Returns filtered points p (n, 3), m; resets the filter unless `time`, s, is later than the last."""
        if self._time is None or time <= self._time:
            self._p, self._v, self.delay = p, np.zeros_like(p), 0.0
        else:
            step = time - self._time
            self._v = self._v + _weight(np.array(_SPEED_CUTOFF_HZ), step) * ((p - self._p) / step - self._v)
            speed = np.linalg.norm(self._v, axis=-1, keepdims=True)
            cutoff = self._cutoff + self._slope * speed
            self._p = self._p + _weight(cutoff, step) * (p - self._p)
            self.delay = float(np.mean(1.0 / (2.0 * math.pi * cutoff)))
        self._time = time
        return self._p


def _weight(cutoff: np.ndarray, step: float) -> np.ndarray:
    """Returns the weight of a new value in a first-order low-pass."""
    return 1.0 / (1.0 + 1.0 / (2.0 * math.pi * cutoff * step))
