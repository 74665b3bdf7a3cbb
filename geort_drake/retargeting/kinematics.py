"""Exact forward kinematics of a hand's fingertips in torch, batched and differentiable.

Fingers are serial chains of revolute joints from the hand base B; joints may follow others of the same
finger. Each chain transforms its tip point from joint to joint towards the base, so a joint costs one product
of a constant 9×3 matrix with a vector.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from geort_drake.hands.kinematics import FingerChain, HandKinematics
from geort_drake.retargeting.rotations import cross_matrices

__all__ = ["FingerChain", "HandKinematics", "fingertips"]


def fingertips(kinematics: HandKinematics, q: torch.Tensor) -> torch.Tensor:
    """Computes fingertip points p_BF (..., F, 3), m, at joint angles q (..., n), rad.

    Differentiable once, with the dtype and device of q; angles may exceed the limits.
    """
    n = len(kinematics.joint_names)
    if q.shape[-1] != n:
        raise ValueError(f"q must end with {n} joint angles, it has shape {tuple(q.shape)}")
    key = q.dtype, q.device
    if key not in kinematics.constants:
        kinematics.constants[key] = _Chains(kinematics.fingers, *key)
    points = kinematics.constants[key].points(q.reshape(-1, n))
    return points.transpose(0, 1).reshape(*q.shape[:-1], len(kinematics.fingers), 3)


class _Chains:
    """Constants of all fingers in a batch; shorter fingers get fixed joints at their base."""

    def __init__(self, fingers: Sequence[FingerChain], dtype: torch.dtype, device: torch.device):
        m, k = (max(finger.coupling.shape[axis] for finger in fingers) for axis in (0, 1))
        X, axes = np.tile(np.eye(4), (len(fingers), m, 1, 1)), np.zeros((len(fingers), m, 3))
        coupling, indices = np.zeros((len(fingers), k, m)), np.zeros((len(fingers), k), dtype=int)
        for row, finger in enumerate(fingers):
            own, free = m - len(finger.axes), len(finger.joint_indices)
            X[row, own:], axes[row, own:] = finger.X_PJ, finger.axes
            coupling[row, :free, own:] = finger.coupling.T
            indices[row, :free] = finger.joint_indices
        K, R = cross_matrices(axes), X[..., :3, :3]
        # Rodrigues: R_PJ Rot(a, θ) = R_PJ + sin θ · R_PJ K + (1 − cos θ) · R_PJ K²
        stacked = np.concatenate([R, R @ K, R @ K @ K], axis=-2)  # (F, m, 9, 3)

        def constant(array: np.ndarray) -> torch.Tensor:
            return torch.tensor(np.ascontiguousarray(array), dtype=dtype, device=device)

        self.matrices = constant(np.moveaxis(stacked, 1, 0))
        self.offsets = constant(np.moveaxis(X[:, :, :3, 3:], 1, 0))
        every_joint_free = m == k and (coupling == np.eye(k)).all()
        self.coupling = None if every_joint_free else constant(coupling)
        self.p_tip = constant(np.stack([finger.p_tip for finger in fingers])[:, :, None])
        self.indices = torch.tensor(indices.ravel(), device=device)

    def points(self, q: torch.Tensor) -> torch.Tensor:
        """Computes fingertip points (F, N, 3) in B, m, at joint angles q (N, n), rad."""
        fingers = self.p_tip.shape[0]
        angles = q.index_select(1, self.indices).reshape(len(q), fingers, -1).transpose(0, 1)
        if self.coupling is not None:
            angles = torch.bmm(angles, self.coupling)
        return _Tips.apply(angles, self.matrices, self.offsets, self.p_tip)


class _Tips(torch.autograd.Function):
    """Computes fingertip points (G, N, 3) from joint angles (G, N, m), with a fast gradient.

    Autograd would record about eighty small operations; this gradient needs a few large ones. Internally the
    batch is the last axis, (…, 3, N), which is fastest.
    """

    @staticmethod
    def forward(
        ctx: Any, angles: torch.Tensor, matrices: torch.Tensor, offsets: torch.Tensor, p_tip: torch.Tensor
    ) -> torch.Tensor:
        """`matrices` (m, G, 9, 3), `offsets` (m, G, 3, 1) and `p_tip` (G, 3, 1) are constants."""
        angles = angles.permute(2, 0, 1)[:, :, None].contiguous()
        sine, cosine = torch.sin(angles), torch.cos(angles)
        rest = 1.0 - cosine
        p = p_tip.expand(-1, -1, angles.shape[-1])
        turned = []
        for j in reversed(range(len(matrices))):
            # The parts of R_PJ Rot(a, θ) p, see `_Chains`.
            turned.append(torch.bmm(matrices[j], p))
            at_zero, by_sine, by_cosine = turned[-1].split(3, dim=1)
            p = torch.addcmul(at_zero + offsets[j], sine[j], by_sine).addcmul_(rest[j], by_cosine)
        ctx.save_for_backward(sine, cosine, rest, matrices, *turned[::-1])
        return p.mT

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor | None, ...]:  # type: ignore[override]
        sine, cosine, rest, matrices, *turned = ctx.saved_tensors
        gradient = gradient.mT.contiguous()
        slopes = []
        for j, parts in enumerate(turned):
            slopes.append((parts[:, 3:].unflatten(1, (2, 3)) * gradient[:, None]).sum(2))
            if j + 1 < len(turned):
                of_parts = torch.cat([gradient, sine[j] * gradient, rest[j] * gradient], dim=1)
                gradient = torch.bmm(matrices[j].mT, of_parts)
        by_sine, by_cosine = torch.stack(slopes).unbind(2)
        slope = by_sine * cosine[:, :, 0] + by_cosine * sine[:, :, 0]
        return slope.permute(1, 2, 0), None, None, None
