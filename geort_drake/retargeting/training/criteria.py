"""The five criteria of GeoRT (Yin et al. 2025, Section II), one pure function each.

Points are in any length unit. Direction and collision are dimensionless; the others are squared lengths, so
their weights depend on the unit. The paper sums over fingers; these functions average, so that weights do not
depend on the number of fingers.
"""

from collections.abc import Sequence

import torch
from torch.nn.functional import softplus


def direction_loss(d: torch.Tensor, displacement: torch.Tensor, floor: float = 1e-6) -> torch.Tensor:
    """Criterion I, motion preservation: −E ⟨d/|d|, Δ/|Δ|⟩ with Δ = FK∘f(x + d) − FK∘f(x), in [−1, 1].

    Args:
        d: (..., 3) steps of human fingertips.
        displacement: (..., 3) steps Δ of the robot's fingertips.
        floor: length added in quadrature to |d| and |Δ|, so that Δ = 0 counts 0 and has a finite gradient.
    """
    norms = torch.sqrt((d.square().sum(-1) + floor**2) * (displacement.square().sum(-1) + floor**2))
    return -((d * displacement).sum(-1) / norms).mean()


def chamfer_loss(targets: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """Criterion II, C-space coverage: mean_a min_b |a − b|² + mean_b min_a |b − a|², averaged over fingers.

    Args:
        targets: (F, M, 3) samples of each robot fingertip's C-space.
        points: (F, N, 3) robot fingertips to which samples of each human fingertip are mapped.
    """
    with torch.no_grad():
        distances = torch.cdist(targets, points)
        nearest_point = distances.argmin(dim=2)
        nearest_target = distances.argmin(dim=1)
    # Only the nearest points have gradients; this takes a tenth of the time of a gradient through cdist.
    uncovered = (targets - _gather(points, nearest_point)).square().sum(-1).mean()
    outside = (points - _gather(targets, nearest_target)).square().sum(-1).mean()
    return uncovered + outside


def flatness_loss(ahead: torch.Tensor, here: torch.Tensor, behind: torch.Tensor) -> torch.Tensor:
    """Criterion III: E |g(x + d) + g(x − d) − 2 g(x)|² of robot fingertips (..., 3); 0 for affine maps."""
    return (ahead + behind - 2.0 * here).square().sum(-1).mean()


def pinch_loss(
    p_BF: torch.Tensor, pairs: Sequence[tuple[int, int]], pair_weights: torch.Tensor
) -> torch.Tensor:
    """Criterion IV, pinch correspondence: Σ w_ij |p_i − p_j|² / Σ w_ij; 0 without pinches.

    The paper divides by the number of frames; dividing by the weights makes the loss independent of how often
    a person pinched.

    Args:
        p_BF: (N, F, 3) robot fingertips of N hands.
        pairs: P pairs of finger numbers.
        pair_weights: (N, P) weights from `pinch_weights`.
    """
    if not pairs:
        return p_BF.new_zeros(())
    first, second = zip(*pairs, strict=True)
    squares = (p_BF[:, list(first)] - p_BF[:, list(second)]).square().sum(-1)
    total = pair_weights.sum()
    return (pair_weights * squares).sum() / torch.where(total > 0, total, torch.ones_like(total))


def pinch_weights(
    p_HF: torch.Tensor, pairs: Sequence[tuple[int, int]], threshold: float, other_pairs: float = 1.0
) -> torch.Tensor:
    """Computes the weights (N, P) of the pinch criterion for human fingertips (N, F, 3).

    Of the pairs closer than `threshold`, the nearest pair of a frame has weight 1, the others `other_pairs`
    (1 in the paper). All other pairs have weight 0.
    """
    if not pairs:
        return p_HF.new_zeros((len(p_HF), 0))
    first, second = zip(*pairs, strict=True)
    distances = torch.linalg.vector_norm(p_HF[:, list(first)] - p_HF[:, list(second)], dim=-1)
    nearest = distances <= distances.min(dim=1, keepdim=True).values
    closed = (distances < threshold).to(p_HF.dtype)
    return closed * torch.where(nearest, 1.0, other_pairs)


def collision_loss(logits: torch.Tensor) -> torch.Tensor:
    """Criterion V: −E log(1 − sigmoid(logit)) = E softplus(logit), for the classifier's logits (N,)."""
    return softplus(logits).mean()


def _gather(points: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
    return points.gather(1, index[..., None].expand(-1, -1, 3))
