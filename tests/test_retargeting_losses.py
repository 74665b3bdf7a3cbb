"""The losses of `geort` and `geort_coupled` against closed forms and degenerate cases."""

import math

import numpy as np
import pytest
import torch

from geort_drake.retargeting.methods.coupled import losses
from geort_drake.retargeting.training import criteria

PAIRS = [(0, 1), (0, 2)]


def normal(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def value(loss: torch.Tensor, expected: float) -> bool:
    return float(loss) == pytest.approx(expected, rel=1e-5, abs=1e-9)


def test_chamfer_of_a_small_translation_is_twice_its_square():
    """Points farther apart than the translation keep their partners, in both directions."""
    grid = torch.tensor(np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(1, -1, 3))
    shift = torch.tensor([0.1, -0.2, 0.05])
    assert value(criteria.chamfer_loss(grid, grid + shift), 2 * float(shift.square().sum()))


def test_flatness_sees_second_differences_only():
    """None of an affine map, 2 d² of x²; curvature is relative to the first difference."""
    x, d, A = normal(2, 50, 3), 1e-2 * normal(2, 50, 3, seed=1), normal(3, 3, seed=2)
    affine = (x + d) @ A, x @ A, (x - d) @ A
    assert float(criteria.flatness_loss(*affine)) < 1e-24
    assert float(losses.curvature_loss(*affine)) < 1e-20
    step = torch.tensor([[[0.1, 0.0, 0.0]]], dtype=torch.float64)
    parabola = step + step**2, 0 * step, -step + step**2
    assert value(criteria.flatness_loss(*parabola), (2 * 0.1**2) ** 2)
    assert value(losses.curvature_loss(*parabola), (2 * 0.01) ** 2 / 0.11**2)


def test_pinches_are_weighted_and_weights_mark_near_pairs():
    """The nearest pair weighs 1, others under the threshold less; no pinch has no loss and no gradient."""
    p = torch.tensor([[[0.0, 0, 0], [1.0, 0, 0], [0.0, 2, 0]]])
    assert value(criteria.pinch_loss(p, PAIRS, torch.tensor([[1.0, 3.0]])), (1 * 1 + 3 * 4) / 4)
    p = normal(5, 3, 3).requires_grad_(True)
    criteria.pinch_loss(p, PAIRS, torch.zeros(5, 2, dtype=p.dtype)).backward()
    assert float(p.grad.abs().max()) == 0.0
    frames = [[[0.0, 0, 0], [a, 0, 0], [0, b, 0]] for a, b in ((0.010, 0.050), (0.012, 0.008), (0.02, 0.03))]
    expected = torch.tensor([[1.0, 0.0], [0.2, 1.0], [0.0, 0.0]])
    torch.testing.assert_close(criteria.pinch_weights(torch.tensor(frames), PAIRS, 0.015, 0.2), expected)


def test_cross_talk_is_the_ratio_of_the_others_motion():
    """Others that move a quarter as far give ¼; others that rest, and a single finger, give 0."""
    answers = torch.zeros(3, 5, 3, 3, dtype=torch.float64)
    answers[..., 0] = 0.25 * 0.008
    answers[torch.arange(3), :, torch.arange(3), 0] = 0.008
    assert value(losses.cross_talk_loss(answers, floor=1e-9), 0.25)
    answers[answers < 0.008] = 0.0
    assert float(losses.cross_talk_loss(answers)) == 0.0
    assert float(losses.cross_talk_loss(normal(1, 5, 1, 3))) == 0.0


def test_an_even_response_costs_nothing_and_an_uneven_one_its_excess():
    """One gain of three that is ten times as large exceeds the band by log 10 − band."""
    d = 0.01 * torch.nn.functional.normalize(normal(1, 3, 3), dim=-1)
    assert float(losses.uniform_response_loss(d, 1.7 * d, 0.6)) == 0.0
    answer = d * torch.tensor([1.0, 1.0, 10.0])[:, None]
    expected = pytest.approx((math.log(10) - 0.6) / 3, rel=1e-3)
    assert float(losses.uniform_response_loss(d, answer, 0.6)) == expected


def test_pinch_distances_have_a_target_and_apart_fingertips_a_least_distance():
    """e² / (1 + e): 0 at the target, ½ one scale away. Only pairs that the person holds apart cost."""
    distances, weights = torch.tensor([[0.012, 0.5], [0.020, 0.5]]), torch.tensor([[1.0, 0.0], [1.0, 0.0]])
    assert value(losses.pinch_distance_loss(distances, weights, 0.012, 0.008), 0.25)
    assert float(losses.pinch_distance_loss(distances, 0 * weights, 0.012, 0.008)) == 0.0
    distances, apart = torch.tensor([[0.022, 0.022]]), torch.tensor([[True, False]])
    assert float(losses.false_pinch_loss(distances, apart, 0.026, 0.004)) == pytest.approx(1.0, rel=1e-4)
    points = torch.zeros(2, 2, 3, requires_grad=True)
    losses.pair_distances(points, [(0, 1)]).sum().backward()
    assert torch.isfinite(points.grad).all()
