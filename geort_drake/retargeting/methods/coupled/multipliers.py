"""Lagrange multipliers of the constraints on a map's figures."""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Future

from torch import nn

from geort_drake.retargeting.training.background import result_of

START = 0.8  # of training; before, the learning rate is so high that the map is far from its final form
EVERY = 80  # steps between measurements
RATE = 0.7  # per measurement and relative violation
LARGEST = 0.5  # relative violation that counts in one measurement, which keeps the factors stable


class LagrangeMultipliers:
    """Factors of loss weights that rise while a constraint is violated and fall while it is met.

    Coverage can be traded for motion at a nearly constant rate, so small changes of the weights move a map
    far along that line, and the right weights differ between recordings. Therefore targets are fixed and the
    weights adapt: gradient ascent on the multipliers of a constrained problem (Platt and Barr 1987,
    "Constrained differential optimization"). Violations are measured in the background with a copy of the
    network, and take effect when the next measurement begins.

    Attributes:
        factors: name → factor.
    """

    def __init__(self, limits: Mapping[str, tuple[float, float]], measure: Callable[[nn.Module], Future]):
        """Takes the least and the greatest factor of each loss by name.

        `measure` starts to measure the relative violations of a network, by name of the loss.
        """
        self.factors = dict.fromkeys(limits, 1.0)
        self._limits, self._measure = limits, measure
        self._pending: Future | None = None

    def update(self, network: nn.Module, step: int, steps: int) -> None:
        """Updates the factors at step `step` of `steps`."""
        if step / steps < START or step % EVERY:
            return
        if self._pending is not None:
            for name, violation in result_of(self._pending).items():
                if math.isfinite(violation):
                    least, most = self._limits[name]
                    factor = self.factors[name] * math.exp(RATE * min(max(violation, -LARGEST), LARGEST))
                    self.factors[name] = min(max(factor, least), most)
        if step + EVERY < steps:
            self._pending = self._measure(network)
