"""The losses of `geort_coupled`, one pure function each. All are ratios, so weights need no unit.

Lengths are in metres. Direction is `criteria.direction_loss`, collision is in collision_geometry.py.
"""

from collections.abc import Sequence

import torch


def bounded_coverage_loss(points: torch.Tensor, targets: torch.Tensor, radius: float) -> torch.Tensor:
    """E d⁴ / (d⁴ + c⁴): small where a target is reached within c, and at most 1.

    Args:
        points, targets: (..., 3) a target in the robot's space and the point that is nearest to it.
        radius: c, the distance at which a target counts half.
    """
    fourth = ((points - targets) / radius).square().sum(-1).square()
    return (fourth / (fourth + 1.0)).mean()


def cross_talk_loss(answers: torch.Tensor, floor: float = 1e-4) -> torch.Tensor:
    """Mean motion of the other fingertips over that of the moved finger.

    Args:
        answers: (F, N, F, 3) motion of every robot fingertip when human finger i (first axis) moves.
        floor: length added in quadrature to each motion, which keeps the gradient of no motion finite.
    """
    fingers = answers.shape[0]
    if fingers == 1:
        return answers.new_zeros(())
    motion = (torch.sqrt(answers.square().sum(-1) + floor**2) - floor).mean(1)  # (F, F)
    own = motion.diagonal()
    return ((motion.sum(1) - own) / ((fingers - 1) * (own + floor))).mean()


def curvature_loss(ahead: torch.Tensor, here: torch.Tensor, behind: torch.Tensor) -> torch.Tensor:
    """Mean squared second over mean squared first difference per finger, (F, N, 3) each; 0 if affine."""
    second = (ahead + behind - 2.0 * here).square().sum(-1).mean(-1)
    first = (ahead - here).square().sum(-1).mean(-1)
    return (second / (first + 1e-12)).mean()


def uniform_response_loss(d: torch.Tensor, answer: torch.Tensor, band: float) -> torch.Tensor:
    """Mean excess of |log gain − its median| over `band`, gain = |answer| / |d|; (F, N, 3) each."""
    gain = 0.5 * torch.log((answer.square().sum(-1) + 1e-10) / (d.square().sum(-1) + 1e-10))
    median = gain.detach().median(dim=-1, keepdim=True).values
    return torch.relu((gain - median).abs() - band).mean()


def pair_distances(points: torch.Tensor, pairs: Sequence[tuple[int, int]]) -> torch.Tensor:
    """(N, P) distances of pairs of fingertips (N, F, 3); the gradient is finite where they coincide."""
    numbers = torch.tensor([pair[side] for side in (0, 1) for pair in pairs], device=points.device)
    first, second = points.index_select(1, numbers).chunk(2, dim=1)
    return torch.sqrt((first - second).square().sum(-1) + 1e-10)


def pinch_distance_loss(
    distances: torch.Tensor, weights: torch.Tensor, target: float, scale: float
) -> torch.Tensor:
    """Weighted mean of e² / (1 + e), e = |distance − target| / scale: square near, linear far away.

    Args:
        distances, weights: (N, P) of pairs of robot fingertips.
        target: distance at which the fingertips press on each other.
        scale: distance at which the loss turns from square to linear.
    """
    e = (distances - target).abs() / scale
    return (weights * e.square() / (1.0 + e)).sum() / (weights.sum() + 1e-9)


def false_pinch_loss(
    distances: torch.Tensor, apart: torch.Tensor, least: float, scale: float
) -> torch.Tensor:
    """Mean of max(0, least − distance) / scale over pairs (N, P) that the person holds `apart` (bool)."""
    return (torch.relu(least - distances) / scale * apart).sum() / (apart.sum() + 1e-9)
