"""Gaps between shapes against closed forms, and against Drake."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.training.collision_geometry import CollisionGaps, box_gap

CPU = torch.device("cpu")


def gap(R_A, R_B, p_AB, a, b) -> float:
    tensors = [torch.tensor(np.asarray(value, dtype=float))[None] for value in (R_A, R_B, p_AB, a, b)]
    return float(box_gap(*tensors)[0])


@pytest.mark.parametrize(
    ("p_AB", "expected"), [([3, 0, 0], 1.0), ([0, 1.5, 0], -0.5), ([0, 0, 2], 0.0), ([3, 3, 0], 2**0.5)]
)
def test_parallel_cubes_and_a_point(p_AB, expected):
    """Unit half edges: face to face; for a point at a corner the distance is Euclidean."""
    eye = np.eye(3)
    b = [1, 1, 1] if expected != 2**0.5 else [0, 0, 0]
    p = p_AB if expected != 2**0.5 else [2, 2, 0]
    assert gap(eye, eye, p, [1, 1, 1], b) == pytest.approx(expected, abs=1e-6)


def test_crossed_edges_are_separated_by_their_product():
    """Two cubes on edge, crossing at right angles: the gap along z is the height minus 2√2."""
    R_A, R_B = Rotation.from_euler("x", 45, True).as_matrix(), Rotation.from_euler("y", 45, True).as_matrix()
    for height in (2.5, 3.5):
        expected = height - 2 * 2**0.5
        assert gap(R_A, R_B, [0, 0, height], [1, 1, 1], [1, 1, 1]) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("name", ["allegro_right", "leap_right"])
def test_gaps_agree_with_drake(name):
    """The sign of the least gap is Drake's answer, except where a cylinder's rim decides."""
    hand = HandModel(load_hand(name))
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
