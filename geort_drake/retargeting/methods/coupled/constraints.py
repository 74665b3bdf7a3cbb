"""Lagrange multipliers that adapt during a training."""

import math
from collections.abc import Mapping

import torch

VIOLATIONS = (-0.5, 1.5)  # relative violations are clipped to this range
BOUNDS = (0.1, 30.0)  # of multipliers, without the proportional part
AVERAGING = 0.02  # weight of the latest figure in its running mean


class Multipliers:
    """One multiplier per constraint figure ≤ bound, adapted by multiplicative dual ascent.

    A proportional part reacts to a violation at once, which matters in short trainings (Stooke et al. 2020,
    "Responsive safety in reinforcement learning by PID Lagrangian methods"). The figures of batches are
    noisy, so each is averaged over about fifty batches.

    Attributes:
        values: multiplier of each constraint.
        figures: running mean of each figure.
    """

    def __init__(self, bounds: Mapping[str, float], start: float, rate: float, proportion: float):
        """Takes the bound of each constraint.

        Args:
            start: initial value of all multipliers.
            rate: change of a multiplier's logarithm per step for a relative violation of 1.
            proportion: addition to the logarithm while such a violation lasts.
        """
        self._bounds, self._rate, self._proportion = dict(bounds), rate, proportion
        self.values = dict.fromkeys(bounds, start)
        self._integrals = dict(self.values)
        self.figures: dict[str, float] = {}

    def update(self, figures: Mapping[str, torch.Tensor]) -> None:
        """Updates the multipliers from the figures of a batch, which may lack some constraints."""
        for name, figure in figures.items():
            value = float(figure.detach())
            mean = self.figures.get(name, value)
            self.figures[name] = mean = mean + AVERAGING * (value - mean)
            violation = min(max(mean / self._bounds[name] - 1.0, VIOLATIONS[0]), VIOLATIONS[1])
            value = self._integrals[name] * math.exp(self._rate * violation)
            self._integrals[name] = value = min(max(value, BOUNDS[0]), BOUNDS[1])
            self.values[name] = value * math.exp(self._proportion * violation)
