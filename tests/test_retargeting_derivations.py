"""The losses, and the derivations of the documentation, checked by computation."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from geort_drake.retargeting.methods.coupled.coverage import RADIUS, coverage_loss
from geort_drake.retargeting.methods.coupled.losses import PINCH_SCALE, PINCH_TARGET, pinch_loss
from geort_drake.retargeting.training import criteria


def sphere(count: int = 20_000) -> np.ndarray:
    """(N, 3) directions spread evenly over the sphere along a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, math.pi * (1.0 + math.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])


def mean_cosine(A: np.ndarray) -> float:
    """Motion preservation of x ↦ A x + b, through the loss itself."""
    d = torch.tensor(sphere())
    return -float(criteria.direction_loss(d, d @ torch.tensor(A).T, floor=1e-12))


def gradient(loss, x: torch.Tensor) -> torch.Tensor:
    x = x.clone().requires_grad_(True)
    return torch.autograd.grad(loss(x), x)[0]


def normal(*shape, seed=0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_the_direction_gradient_turns_and_never_stretches():
    """It is −(û − cos v̂) / |Δ|: orthogonal to Δ, of size sin / |Δ|."""
    d, delta = normal(40, 3), normal(40, 3, seed=1)
    g = gradient(lambda x: criteria.direction_loss(d, x, floor=1e-12), delta) * len(d)
    u, v = d / d.norm(dim=-1, keepdim=True), delta / delta.norm(dim=-1, keepdim=True)
    cosine = (u * v).sum(-1, keepdim=True)
    torch.testing.assert_close(g, -(u - cosine * v) / delta.norm(dim=-1, keepdim=True))
    assert (g * delta).sum(-1).abs().max() < 1e-12
    size = torch.sqrt(1 - cosine[:, 0] ** 2) / delta.norm(dim=-1)
    torch.testing.assert_close(g.norm(dim=-1), size, atol=1e-9, rtol=1e-9)


def test_the_floor_bounds_the_direction_gradient_where_nothing_moves():
    """At Δ = 0 the loss is 0 and its gradient −û / floor."""
    d, floor = normal(10, 3), 1e-3
    g = gradient(lambda x: criteria.direction_loss(d, x, floor), torch.zeros(10, 3, dtype=torch.float64))
    expected = -d / torch.sqrt(d.square().sum(-1, keepdim=True) + floor**2) / floor
    torch.testing.assert_close(g * len(d), expected)


@pytest.mark.parametrize(
    ("A", "cosine"),
    [
        (np.diag([1.93, 1.0, 1.0]), 0.97),
        (np.diag([2.22, 2.22**0.5, 1.0]), 0.97),
        (Rotation.from_rotvec(np.deg2rad(17.25) * np.array([0.6, 0.0, 0.8])).as_matrix(), 0.97),
        (np.diag([46 / 34, 26 / 18, 21 / 4.5]), 0.906),
    ],
    ids=["one stiff direction", "evenly spread", "rotation", "a person's cloud to the robot's"],
)
def test_mean_cosines_are_those_of_the_page(A, cosine):
    assert mean_cosine(A) == pytest.approx(cosine, abs=5e-4)


def test_small_anisotropy_costs_three_tenths_of_its_variance():
    """1 − 0.3 (standard deviation / mean)² of the singular values."""
    s = np.array([1.1, 1.0, 0.93])
    assert 1.0 - mean_cosine(np.diag(s)) == pytest.approx(0.3 * s.var() / s.mean() ** 2, rel=0.05)


def test_flatness_is_the_energy_of_the_hessian():
    """For quadratic maps and steps of deviation σ: σ⁴ Σ (2 |H|² + (tr H)²) over the coordinates, exactly."""
    H, b = normal(3, 3, 3), normal(3, 3, seed=1)
    H = H + H.transpose(1, 2)
    x, d = normal(200_000, 3, seed=2), 0.3 * normal(200_000, 3, seed=3)

    def g(p):
        return 0.5 * torch.einsum("ni,kij,nj->nk", p, H, p) + p @ b

    energy = float((2 * H.square().sum((1, 2)) + torch.einsum("kii->k", H).square()).sum())
    value = float(criteria.flatness_loss(g(x + d), g(x), g(x - d)))
    assert value == pytest.approx(0.3**4 * energy, rel=0.03)


def test_bounded_coverage_pulls_hardest_just_within_its_radius():
    """At 0.88 c by 1.065 / c, and beyond less and less: 4c⁴ / d⁵ in the limit."""
    c = RADIUS
    d = torch.linspace(1e-4, 0.2, 20_000, dtype=torch.float64)
    points = torch.stack([d, 0 * d, 0 * d], dim=1)
    slope = gradient(lambda p: coverage_loss(p, 0 * p).sum(), points)[:, 0]
    assert float(d[slope.argmax()]) == pytest.approx(0.6**0.25 * c, abs=1e-5)
    assert float(slope.max()) == pytest.approx(25 / 16 * 0.6**0.75 / c, rel=1e-5)
    assert float(slope[-1]) == pytest.approx(4 * c**4 / 0.2**5, rel=0.01)


def test_the_loss_of_open_pinches_pulls_evenly_from_afar():
    """Its slope e (2 + e) / (1 + e)² rises from 0 to 1 per scale, and never falls."""
    e = torch.linspace(0.01, 20.0, 400, dtype=torch.float64)
    distances = PINCH_TARGET + PINCH_SCALE * e
    slope = gradient(lambda d: pinch_loss(d).sum(), distances)
    torch.testing.assert_close(PINCH_SCALE * slope, e * (2 + e) / (1 + e) ** 2, rtol=1e-6, atol=1e-6)
    assert (slope.diff() > 0).all()


def test_chamfer_of_a_small_translation_is_twice_its_square():
    """Points farther apart than the translation keep their partners, in both directions."""
    grid = torch.tensor(np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(1, -1, 3))
    shift = torch.tensor([0.1, -0.2, 0.05])
    loss = float(criteria.chamfer_loss(grid, grid + shift))
    assert loss == pytest.approx(2 * float(shift.square().sum()), rel=1e-5)


def test_pinches_are_weighted_and_weights_mark_near_pairs():
    """The nearest pair weighs 1, others under the threshold less; no pinch has no loss and no gradient."""
    pairs = [(0, 1), (0, 2)]
    p = torch.tensor([[[0.0, 0, 0], [1.0, 0, 0], [0.0, 2, 0]]])
    loss = float(criteria.pinch_loss(p, pairs, torch.tensor([[1.0, 3.0]])))
    assert loss == pytest.approx((1 * 1 + 3 * 4) / 4)
    p = normal(5, 3, 3).requires_grad_(True)
    criteria.pinch_loss(p, pairs, torch.zeros(5, 2, dtype=p.dtype)).backward()
    assert float(p.grad.abs().max()) == 0.0
    frames = [[[0.0, 0, 0], [a, 0, 0], [0, b, 0]] for a, b in ((0.010, 0.050), (0.012, 0.008), (0.02, 0.03))]
    expected = torch.tensor([[1.0, 0.0], [0.2, 1.0], [0.0, 0.0]])
    torch.testing.assert_close(criteria.pinch_weights(torch.tensor(frames), pairs, 0.015, 0.2), expected)
