"""Weights of losses that follow from the value which a loss should have."""

import math
from collections.abc import Collection

import torch

RATE = 5e-4  # per step and relative error; the map answers a weight faster, within some hundred steps
RANGE = 1.2  # times more or less, so that a value that cannot be had costs the other losses little
FROM = 0.1  # of the descent; before, the map has no shape


class Prices:
    """Factors of some losses' weights, which rise while the loss is above what is wanted of it.

    Motion can be given up for coverage at a nearly constant rate, so a map whose weights are a few per cent
    off goes far along that line, and the right weights differ from one recording to the next. Fixed is
    therefore what should come out, and the weights find themselves: gradient ascent on the multipliers of a
    constrained problem (Platt and Barr 1987, "Constrained differential optimization").
    """

    def __init__(self, wanted: dict[str, float], may_fall: Collection[str] = ()):
        """Takes the value that each loss should have; a negative one is of a mean cosine, −1 at best.

        Weights of the losses `may_fall` fall while the loss is better than wanted, others only rise.
        """
        self._wanted = wanted
        self._factors = dict.fromkeys(wanted, 1.0)
        self._least = {name: 1.0 / RANGE if name in may_fall else 1.0 for name in wanted}

    def follow(self, row: dict[str, torch.Tensor], progress: float) -> dict[str, float]:
        """The factors for a step whose losses are `row`, `progress` (0 to 1) through the descent."""
        if progress > FROM:
            for name, wanted in self._wanted.items():
                error = (float(row[name].detach()) - wanted) / (1.0 + wanted if wanted < 0 else wanted)
                factor = self._factors[name] * math.exp(RATE * error)
                self._factors[name] = min(max(factor, self._least[name]), RANGE)
        return dict(self._factors)
