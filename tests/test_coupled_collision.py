"""Gaps between shapes against closed forms, and against Drake."""

import numpy as np
import pytest
import torch
from retargeting_toy import toy_kinematics
from scipy.spatial.transform import Rotation

from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.training.collision_geometry import CollisionGaps, CollisionShapes, box_gap

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


def test_gradient_of_the_loss_equals_finite_differences():
    """Two spheres on the toy hand's fingertips, pushed into each other."""
    hand = toy_kinematics(("thumb", "index"))
    X = np.tile(np.eye(4), (2, 1, 1))
    X[:, 2, 3] = 0.04
    shapes = CollisionShapes(
        np.array([2, 5]), X, np.zeros((2, 3)), np.array([0.02, 0.02]), np.array([[0, 1]])
    )
    gaps = CollisionGaps(hand, shapes)
    q = torch.tensor([[0.0, 0.3, 0.5, 0.05, 0.4, 0.5]], requires_grad=True)
    near = torch.tensor([0]), torch.tensor([0])
    loss = gaps.loss(q, *near, 0.001, 0.005)
    tips = hand.fingertips(q.detach().double())[0]
    distance = float((tips[0] - tips[1]).norm())
    assert loss.item() == pytest.approx((0.001 - (distance - 0.04)) / 0.005, rel=1e-3)
    loss.backward()
    for j in range(6):
        d = torch.zeros(1, 6)
        d[0, j] = 1e-2
        more, less = (gaps.loss(q.detach() + sign * d, *near, 0.001, 0.005) for sign in (1, -1))
        assert float(q.grad[0, j]) == pytest.approx(float(more - less) / 2e-2, abs=0.02)


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


def test_shapes_mirror_with_the_kinematics(allegro):
    """The mirrored hand is as far from touching itself at the same q."""
    q = torch.tensor(np.random.default_rng(1).uniform(allegro.lower, allegro.upper, (100, 16))).float()
    shapes, kinematics = collision_shapes(allegro), allegro.kinematics()
    a = CollisionGaps(kinematics, shapes).least(q, 0.01)
    b = CollisionGaps(kinematics.mirrored(), shapes.mirrored()).least(q, 0.01)
    torch.testing.assert_close(a, b, atol=1e-5, rtol=0)
