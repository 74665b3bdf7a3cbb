"""Weights of losses that follow from the figures which the map should have."""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Future

from torch import nn

from geort_drake.retargeting.training.background import result_of

FROM = 0.8  # of the descent; before, the learning rate keeps the map from what it will be
EVERY = 80  # steps between measurements
RATE = 0.7  # per measurement and relative error
LARGEST = 0.5  # relative error that counts in one measurement, so that none turns a weight over


class Prices:
    """Factors of some losses' weights, which rise while a figure is worse than wanted and fall while better.

    Motion can be given up for coverage at a nearly constant rate, so a map whose weights are a few per cent
    off goes far along that line, and the right weights differ from one recording to the next. Fixed is
    therefore what should come out, and the weights find themselves: gradient ascent on the multipliers of a
    constrained problem (Platt and Barr 1987, "Constrained differential optimization"). Figures are measured
    beside the descent, with a copy of the map, and count when the next measurement begins.

    Attributes:
        factors: name → factor.
    """

    def __init__(self, limits: Mapping[str, tuple[float, float]], measure: Callable[[nn.Module], Future]):
        """Takes a name and the least and the greatest factor of each loss.

        `measure` begins to find by how much of it each figure is worse than wanted, negative where it is
        better.
        """
        self.factors = dict.fromkeys(limits, 1.0)
        self._limits, self._measure = limits, measure
        self._coming: Future | None = None

    def follow(self, network: nn.Module, step: int, steps: int) -> None:
        """Brings the factors up to date for a step of `steps`."""
        if step / steps < FROM or step % EVERY:
            return
        if self._coming is not None:
            for name, error in result_of(self._coming).items():
                if math.isfinite(error):
                    least, most = self._limits[name]
                    factor = self.factors[name] * math.exp(RATE * min(max(error, -LARGEST), LARGEST))
                    self.factors[name] = min(max(factor, least), most)
        if step + EVERY < steps:
            self._coming = self._measure(network)
