"""Weights that follow from what is wanted of a loss."""

import pytest
import torch

from geort_drake.retargeting.coupled_prices import FROM, RANGE, Prices


@pytest.mark.parametrize("start", [0.9, 1.1])
@pytest.mark.parametrize("name, wanted, best", [("track", -0.97, -1.0), ("cross_talk", 0.04, 0.0)])
def test_a_loss_that_its_weight_can_move_becomes_what_is_wanted(name, wanted, best, start):
    """From above and from below, for a cosine and for a ratio."""
    prices, factor = Prices({name: wanted}, may_fall=[name]), 1.0
    for _ in range(20_000):
        loss = best + start * (wanted - best) / factor
        factor = prices.follow({name: torch.tensor(loss)}, 0.5)[name]
    assert factor == pytest.approx(start, rel=0.005)


def test_what_cannot_be_had_costs_no_more_than_the_range():
    """Nor does what is better than wanted lose more of its weight, or any that may not fall."""
    prices = Prices(
        {"track": -0.97, "cross_talk": 0.04, "direction": -0.97}, may_fall=["track", "cross_talk"]
    )
    row = {"track": torch.tensor(-0.5), "cross_talk": torch.tensor(0.0), "direction": torch.tensor(-0.99)}
    for _ in range(5000):
        factors = prices.follow(row, 0.5)
    assert factors == pytest.approx({"track": RANGE, "cross_talk": 1.0 / RANGE, "direction": 1.0})


def test_nothing_is_priced_before_the_map_has_a_shape():
    """The first losses are far from what any map has at the end."""
    prices = Prices({"track": -0.97})
    for _ in range(1000):
        assert prices.follow({"track": torch.tensor(0.0)}, FROM) == {"track": 1.0}
