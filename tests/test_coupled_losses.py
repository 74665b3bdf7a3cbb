"""The losses of `geort_coupled` against closed forms, finite differences and degenerate cases."""

import math

import pytest
import torch

from geort_drake.retargeting.methods.coupled import losses


def normal(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_coverage_is_half_at_its_radius_and_bounded():
    """d⁴ / (d⁴ + c⁴) is 0 at d = 0, ½ at d = c and never above 1."""
    targets = torch.zeros(1, 3)
    for distance, expected in ((0.0, 0.0), (0.01, 0.5), (0.03, 81 / 82), (1e3, 1.0)):
        points = torch.tensor([[distance, 0.0, 0.0]])
        assert float(losses.bounded_coverage_loss(points, targets, 0.01)) == pytest.approx(expected, abs=1e-6)


def test_cross_talk_is_the_ratio_of_the_others_motion():
    """Others that move a quarter as far give ¼, whatever the unit of motion; still others give 0."""
    answers = torch.zeros(3, 5, 3, 3, dtype=torch.float64)
    answers[..., 0] = 0.25 * 0.008
    answers[torch.arange(3), :, torch.arange(3), 0] = 0.008
    assert float(losses.cross_talk_loss(answers, floor=1e-9)) == pytest.approx(0.25, rel=1e-5)
    answers[answers < 0.008] = 0.0
    assert float(losses.cross_talk_loss(answers)) == 0.0
    assert float(losses.cross_talk_loss(normal(1, 5, 1, 3))) == 0.0


def test_an_affine_map_is_flat_and_a_parabola_is_not():
    """x + x² has second difference 2d² over a first of d + 2xd + d²."""
    x, d, A = normal(2, 50, 3), 1e-2 * normal(2, 50, 3, seed=1), normal(3, 3, seed=2)
    assert float(losses.curvature_loss((x + d) @ A, x @ A, (x - d) @ A)) < 1e-20
    zero = torch.zeros(1, 1, 3, dtype=torch.float64)
    step = torch.tensor([[[0.1, 0.0, 0.0]]], dtype=torch.float64)
    value = losses.curvature_loss(step + step**2, zero, -step + step**2)
    assert float(value) == pytest.approx((2 * 0.01) ** 2 / 0.11**2, rel=1e-6)


def test_an_even_response_costs_nothing_and_an_uneven_one_its_excess():
    """One gain for all is free; one of three ten times as large exceeds the band by log 10 − band."""
    d = 0.01 * torch.nn.functional.normalize(normal(1, 3, 3), dim=-1)
    assert float(losses.uniform_response_loss(d, 1.7 * d, 0.6)) == 0.0
    answer = d * torch.tensor([1.0, 1.0, 10.0])[:, None]
    expected = (math.log(10) - 0.6) / 3
    assert float(losses.uniform_response_loss(d, answer, 0.6)) == pytest.approx(expected, rel=1e-3)


def test_pinch_is_best_at_the_target_distance():
    """e² / (1 + e): 0 where expected, ½ one scale away; weights select the pairs."""
    distances = torch.tensor([[0.012, 0.5], [0.020, 0.5]])
    weights = torch.tensor([[1.0, 0.0], [1.0, 0.0]])
    assert float(losses.pinch_distance_loss(distances, weights, 0.012, 0.008)) == pytest.approx(
        0.25, rel=1e-5
    )
    assert float(losses.pinch_distance_loss(distances, 0 * weights, 0.012, 0.008)) == 0.0


def test_false_pinches_cost_only_where_the_person_is_apart():
    """Two robot pairs 4 mm too close, one of them meant: the mean over those held apart counts."""
    distances, apart = torch.tensor([[0.022, 0.022]]), torch.tensor([[True, False]])
    assert float(losses.false_pinch_loss(distances, apart, 0.026, 0.004)) == pytest.approx(1.0, rel=1e-4)
    assert float(losses.false_pinch_loss(distances, ~apart & apart, 0.026, 0.004)) == 0.0


def test_fingertips_in_one_place_have_a_finite_gradient():
    """The distance's slope is undefined at zero, its gradient must not be NaN."""
    points = torch.zeros(2, 2, 3, requires_grad=True)
    losses.pair_distances(points, [(0, 1)]).sum().backward()
    assert torch.isfinite(points.grad).all()


@pytest.mark.parametrize(
    "loss",
    [
        lambda x: losses.bounded_coverage_loss(x[:, :, 0], x[:, :, 1], 1.0),
        lambda x: losses.cross_talk_loss(x, 0.1),
        lambda x: losses.curvature_loss(x[..., 0, :], x[..., 1, :], x[..., 2, :]),
        lambda x: losses.pinch_distance_loss(
            losses.pair_distances(x[0], [(0, 1), (0, 2)]), torch.ones(4, 2), 0.3, 0.5
        ),
    ],
)
def test_gradients_equal_finite_differences(loss):
    """torch.autograd.gradcheck in float64."""
    assert torch.autograd.gradcheck(loss, (normal(3, 4, 3, 3).requires_grad_(),), eps=1e-6, atol=1e-5)
