"""The losses, and the derivations of the documentation, checked by computation."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from geort_drake.retargeting import geort


def sphere(count: int = 20_000) -> np.ndarray:
    """(N, 3) directions spread evenly over the sphere along a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, math.pi * (1.0 + math.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])


def mean_cosine(A: np.ndarray) -> float:
    """Motion preservation of x ↦ A x + b, through the loss itself."""
    d = torch.tensor(sphere())
    return -float(geort.direction_loss(d[:, None], (d @ torch.tensor(A).T)[:, None]))


def gradient(loss, x: torch.Tensor) -> torch.Tensor:
    x = x.clone().requires_grad_(True)
    return torch.autograd.grad(loss(x), x)[0]


def normal(*shape, seed=0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_the_direction_gradient_turns_and_never_stretches():
    """It is −(û − cos v̂) / |Δ|: orthogonal to Δ, of size sin / |Δ|."""
    d, delta = normal(40, 3), normal(40, 3, seed=1)
    g = gradient(lambda x: geort.direction_loss(d[:, None], x[:, None]), delta) * len(d)
    u, v = d / d.norm(dim=-1, keepdim=True), delta / delta.norm(dim=-1, keepdim=True)
    cosine = (u * v).sum(-1, keepdim=True)
    torch.testing.assert_close(g, -(u - cosine * v) / delta.norm(dim=-1, keepdim=True))
    assert (g * delta).sum(-1).abs().max() < 1e-12
    size = torch.sqrt(1 - cosine[:, 0] ** 2) / delta.norm(dim=-1)
    torch.testing.assert_close(g.norm(dim=-1), size, atol=1e-9, rtol=1e-9)


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
    ahead, here, behind = (g(p)[:, None] for p in (x + d, x, x - d))
    value = float(geort.flatness_loss(ahead, here, behind))
    assert value == pytest.approx(0.3**4 * energy, rel=0.03)


def test_chamfer_of_a_small_translation_is_twice_its_square():
    """Points farther apart than the translation keep their partners, in both directions."""
    grid = torch.tensor(np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(-1, 1, 3))
    shift = torch.tensor([0.1, -0.2, 0.05])
    loss = float(geort.cover_loss(grid, grid + shift))
    assert loss == pytest.approx(2 * float(shift.square().sum()), rel=1e-5)


def test_pinches_are_near_pairs_of_any_two_fingers():
    """Each counts twice, as (i, j) and (j, i), in the mean over all hands; other pairs have no gradient."""
    x_H = torch.tensor(
        [[[0.0, 0, 0], [0.009, 0, 0], [0, 0.05, 0]], [[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.008, 0]]]
    )
    x_R = torch.tensor([[[0.0, 0, 0], [1.0, 0, 0], [0, 7, 0]], [[7.0, 0, 0], [0, 0, 0], [0, 2, 0]]])
    x_R.requires_grad_(True)
    loss = geort.pinch_loss(x_H, x_R, 0.01)
    assert float(loss) == pytest.approx((2 * 1 + 2 * 4) / 2)
    loss.backward()
    assert float(x_R.grad[0, 2].abs().max()) == float(x_R.grad[1, 0].abs().max()) == 0.0
