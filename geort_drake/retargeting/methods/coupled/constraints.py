"""Lagrange multipliers that adapt from the first step of a training on."""

import math
from collections.abc import Mapping

import torch

RATE = 0.02  # change of a multiplier's logarithm per step, for a relative violation of 1
VIOLATIONS = (-0.5, 1.5)  # beyond these, a violation changes no more
BOUNDS = (0.1, 30.0)  # of multipliers
START = 3.0
AVERAGING = 0.02  # weight of the latest figure in its running mean


class Multipliers:
    """One multiplier per constraint figure ≤ bound, by multiplicative dual ascent.

    The figures of batches are noisy, so each is averaged over some fifty batches.

    Attributes:
        values: multiplier of each constraint.
        figures: running mean of each figure.
    """

    def __init__(self, bounds: Mapping[str, float]):
        self._bounds = dict(bounds)
        self.values = dict.fromkeys(bounds, START)
        self.figures: dict[str, float] = {}

    def update(self, figures: Mapping[str, torch.Tensor]) -> None:
        """Takes the figures of a batch; those of some constraints may be missing."""
        for name, figure in figures.items():
            value = float(figure.detach())
            mean = self.figures.get(name, value)
            self.figures[name] = mean = mean + AVERAGING * (value - mean)
            violation = min(max(mean / self._bounds[name] - 1.0, VIOLATIONS[0]), VIOLATIONS[1])
            value = self.values[name] * math.exp(RATE * violation)
            self.values[name] = min(max(value, BOUNDS[0]), BOUNDS[1])
