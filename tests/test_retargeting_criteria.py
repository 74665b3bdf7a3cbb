"""The five criteria against closed forms, finite differences and invariances."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from geort_drake.retargeting.training.criteria import (
    chamfer_loss,
    collision_loss,
    direction_loss,
    flatness_loss,
    pinch_loss,
    pinch_weights,
)

PAIRS = [(0, 1), (0, 2)]


def random(rng, *shape):
    return torch.tensor(rng.normal(size=shape))


def check_gradient(function, x):
    """Compares autograd with central differences, in float64."""
    x = x.clone().requires_grad_(True)
    (gradient,) = torch.autograd.grad(function(x), x)
    numeric = torch.zeros_like(x)
    step = 1e-6
    with torch.no_grad():
        for k in range(x.numel()):
            e = torch.zeros_like(x)
            e.view(-1)[k] = step
            numeric.view(-1)[k] = (function(x + e) - function(x - e)) / (2 * step)
    assert gradient.abs().max() > 1e-3, "a gradient of zero would compare equal to anything flat"
    torch.testing.assert_close(gradient, numeric, rtol=1e-5, atol=1e-7)


def test_direction_of_a_rotation_is_minus_the_mean_cosine(rng):
    """A rotation by θ about z answers steps in the plane at angle θ."""
    theta = 0.7
    d = random(rng, 100, 1, 3)
    d[..., 2] = 0.0
    R = torch.tensor(Rotation.from_euler("z", theta).as_matrix())
    assert float(direction_loss(d, d @ R.T)) == pytest.approx(-math.cos(theta), abs=1e-9)


def test_an_unanswered_step_counts_zero_and_keeps_the_gradient_finite(rng):
    """A map that does not move is as good as one that moves at random."""
    d = random(rng, 10, 4, 3)
    still = torch.zeros_like(d, requires_grad=True)
    loss = direction_loss(d, still)
    loss.backward()
    assert float(loss.detach()) == 0.0
    assert torch.isfinite(still.grad).all()


def test_chamfer_of_a_small_translation_is_twice_its_square():
    """Points farther apart than the translation keep their partners, in both directions."""
    grid = torch.tensor(np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(1, -1, 3))
    shift = torch.tensor([0.1, -0.2, 0.05])
    assert float(chamfer_loss(grid, grid + shift)) == pytest.approx(2 * float(shift.square().sum()), rel=1e-6)


def test_flatness_of_an_affine_map_is_zero(rng):
    """The second difference of an affine map vanishes."""
    A, b = random(rng, 3, 3), random(rng, 3)
    x, d = random(rng, 30, 4, 3), random(rng, 30, 4, 3)
    loss = flatness_loss((x + d) @ A + b, x @ A + b, (x - d) @ A + b)
    assert float(loss) == pytest.approx(0.0, abs=1e-24)


def test_flatness_of_a_parabola_is_its_second_difference(rng):
    """For x ↦ (x², 0, 0) the second difference along d is 2 d²."""
    x, d = random(rng, 30, 1, 3), random(rng, 30, 1, 3)
    keep = torch.tensor([1.0, 0.0, 0.0])

    def f(points):
        return points.square() * keep

    expected = float((2 * d[..., 0].square()).square().mean())
    assert float(flatness_loss(f(x + d), f(x), f(x - d))) == pytest.approx(expected, rel=1e-9)


def test_pinch_is_the_weighted_mean_square_of_pinching_pairs():
    """Two pairs by hand: |(1,0,0)|² with weight 1 and |(0,2,0)|² with weight 3."""
    p = torch.tensor([[[0.0, 0, 0], [1.0, 0, 0], [0.0, 2, 0]]])
    weights = torch.tensor([[1.0, 3.0]])
    assert float(pinch_loss(p, PAIRS, weights)) == pytest.approx((1 * 1 + 3 * 4) / 4)


def test_pinch_without_pinching_pairs_is_zero_with_a_zero_gradient(rng):
    """An empty mask must not divide by zero."""
    p = random(rng, 5, 3, 3).requires_grad_(True)
    loss = pinch_loss(p, PAIRS, torch.zeros(5, 2, dtype=p.dtype))
    loss.backward()
    assert float(loss.detach()) == 0.0
    assert float(p.grad.abs().max()) == 0.0


def test_pinch_weights_mark_the_nearest_pair_and_those_under_the_threshold():
    """Three frames: only one near, both near, none near."""

    def frame(a, b):
        return [[0.0, 0, 0], [a, 0, 0], [0, b, 0]]

    p = torch.tensor([frame(0.010, 0.050), frame(0.012, 0.008), frame(0.020, 0.030)])
    expected = torch.tensor([[1.0, 0.0], [0.2, 1.0], [0.0, 0.0]])
    torch.testing.assert_close(pinch_weights(p, PAIRS, 0.015, other_pairs=0.2), expected)


def test_collision_loss_is_minus_log_of_the_free_probability():
    """−log(1 − C) with C = sigmoid(z), also where the sigmoid is one in floating point."""
    z = torch.tensor([-2.0, 0.0, 1.5], dtype=torch.float64)
    expected = float((-torch.log(1 - torch.sigmoid(z))).mean())
    assert float(collision_loss(z)) == pytest.approx(expected, rel=1e-12)
    assert float(collision_loss(torch.tensor([1000.0]))) == pytest.approx(1000.0)


def test_gradients_agree_with_finite_differences(rng):
    """Every criterion's gradient, in float64."""
    d, b, c = random(rng, 5, 2, 3), random(rng, 5, 2, 3), random(rng, 5, 2, 3)
    check_gradient(lambda x: direction_loss(d, x), random(rng, 5, 2, 3))
    check_gradient(lambda x: flatness_loss(b, x, c), random(rng, 5, 2, 3))
    targets = random(rng, 2, 12, 3)
    check_gradient(lambda x: chamfer_loss(targets, x), random(rng, 2, 7, 3))
    weights = torch.tensor(rng.uniform(size=(6, 2)))
    check_gradient(lambda x: pinch_loss(x, PAIRS, weights), random(rng, 6, 3, 3))
    check_gradient(collision_loss, random(rng, 9))
