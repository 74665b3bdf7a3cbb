"""The losses of `geort` against closed forms and degenerate cases."""

import numpy as np
import pytest
import torch

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
    """None of an affine map, 2 d² of x²."""
    x, d, A = normal(2, 50, 3), 1e-2 * normal(2, 50, 3, seed=1), normal(3, 3, seed=2)
    affine = (x + d) @ A, x @ A, (x - d) @ A
    assert float(criteria.flatness_loss(*affine)) < 1e-24
    step = torch.tensor([[[0.1, 0.0, 0.0]]], dtype=torch.float64)
    parabola = step + step**2, 0 * step, -step + step**2
    assert value(criteria.flatness_loss(*parabola), (2 * 0.1**2) ** 2)


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
