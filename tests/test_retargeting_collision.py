"""The batched gaps between the collision shapes of a hand."""

import numpy as np
import pytest
import torch

from geort_drake import Hand
from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.retargeting.collision import CollisionGaps


@pytest.mark.parametrize("name", ["allegro_right", "leap_right"])
def test_gaps_agree_with_drake(name):
    """The sign of the least gap is Drake's answer, except where a cylinder's rim decides."""
    hand = Hand(name)
    q = np.random.default_rng(0).uniform(hand.lower, hand.upper, (1500, 16))
    shapes = collision_shapes(hand)
    gaps = CollisionGaps(hand.kinematics(), shapes)
    before = len(gaps.pairs)
    least = gaps.least(torch.tensor(q).float(), 0.002).numpy()
    label = hand.collides_beyond_tips(q)
    assert ((least < 0) == label).mean() > 0.99
    gaps.keep_pairs_that_meet(torch.tensor(q).float(), 0.001)
    assert len(gaps.pairs) < before
    after = gaps.least(torch.tensor(q).float(), 0.002).numpy()
    np.testing.assert_array_equal(after < 0, least < 0)
