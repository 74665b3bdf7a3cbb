"""Weights that follow from the figures which a map should have."""

import math
from functools import partial

import pytest
import torch
from torch import nn

from geort_drake.retargeting.methods.coupled.multipliers import EVERY, FROM, LARGEST, RATE, Prices
from geort_drake.retargeting.training.background import Beside


class Map(nn.Module):
    """A map of one number."""

    def __init__(self, value: float = 1.0):
        super().__init__()
        self.value = nn.Parameter(torch.tensor(value))


def prices_of(limits, errors) -> Prices:
    return Prices(limits, partial(Beside({"errors": errors}, process=False).start, "errors"))


def follow(prices: Prices, measurements: int, network: nn.Module) -> None:
    """Lets the end of a descent pass, in which the map becomes the factor of its loss.

    So many measurements count; the one that would end after the descent is not begun.
    """
    steps = round((measurements + 1) * EVERY / (1 - FROM))
    for step in range(round(FROM * steps), steps):
        prices.follow(network, step, steps)
        network.value.data.fill_(prices.factors["coverage"])


@pytest.mark.parametrize("right", [0.9, 1.1])
def test_a_figure_that_its_weight_can_move_becomes_what_is_wanted(right):
    """From above and from below."""

    def errors(network):
        return {"coverage": right / float(network.value.detach()) - 1}

    prices = prices_of({"coverage": (0.5, 1.3)}, errors)
    follow(prices, 60, Map())
    assert prices.factors == pytest.approx({"coverage": right}, rel=1e-3)


def test_what_cannot_be_had_costs_no_more_than_is_allowed():
    """Nor does what is better than wanted lose all of its weight."""
    errors = {"coverage": 0.5, "cross_talk": -0.5, "pinch": -0.5}
    limits = {"coverage": (0.5, 1.2), "cross_talk": (0.7, 1.2), "pinch": (1.0, 3.0)}
    prices = prices_of(limits, lambda network: errors)
    follow(prices, 20, Map())
    assert prices.factors == pytest.approx({"coverage": 1.2, "cross_talk": 0.7, "pinch": 1.0})


@pytest.mark.parametrize("sign", [-1, 1])
def test_one_measurement_turns_no_weight_over(sign):
    """A share that should be small is easily twenty times as large, or none."""
    prices = prices_of({"coverage": (0.1, 9.0)}, lambda network: {"coverage": 20.0 * sign})
    follow(prices, 1, Map())
    assert prices.factors == pytest.approx({"coverage": math.exp(sign * RATE * LARGEST)})


def test_nothing_is_measured_before_the_map_has_a_shape_or_too_late_to_count():
    """The first figures are far from what any map has at the end, and the last ones would change no step."""
    asked = []
    prices = prices_of({"coverage": (0.5, 1.3)}, asked.append)
    for step in range(5 * EVERY):
        prices.follow(Map(), step, 5 * EVERY)
    assert not asked


def test_a_figure_that_is_not_finite_changes_no_weight():
    """A map that moves no finger has no cross-talk to speak of."""
    prices = prices_of({"coverage": (0.5, 1.3)}, lambda network: {"coverage": float("nan")})
    follow(prices, 3, Map())
    assert prices.factors == {"coverage": 1.0}


def test_a_measurement_is_of_the_map_as_it_was_when_it_began():
    """Whatever the descent has done to it in the meantime, so that the outcome does not depend on timing."""
    seen = []

    def errors(network):
        seen.append(float(network.value.detach()))
        return {"coverage": 0.1}

    prices = prices_of({"coverage": (0.5, 1.3)}, errors)
    follow(prices, 2, Map(value=3.0))
    assert seen == [3.0, 1.0]
