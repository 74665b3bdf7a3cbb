"""Exact forward kinematics of a hand in torch, batched and differentiable.

Fingers are serial chains of revolute joints from the hand base B; joints may follow others of the same
finger. For the fingertips, each chain transforms its tip point from joint to joint towards the base, so a
joint costs one product of a constant 9×3 matrix with a vector.
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike

from geort_drake.hands.kinematics import HandKinematics
from geort_drake.retargeting.numpy_kinematics import stacked_chains


def fingertips(kinematics: HandKinematics, q: torch.Tensor) -> torch.Tensor:
    """Computes fingertip points p_BF (..., F, 3), m, at joint angles q (..., n), rad.

    Differentiable once, with the dtype and device of q; angles may exceed the limits.
    """
    n = len(kinematics.joint_names)
    if q.shape[-1] != n:
        raise ValueError(f"q must end with {n} joint angles, it has shape {tuple(q.shape)}")
    key = q.dtype, q.device
    if key not in kinematics.constants:
        R, p_PJ, K, p_tip, indices, coupling = stacked_chains(kinematics)
        stacked = np.concatenate([R, R @ K, R @ K @ K], axis=-2)  # (F, k, 9, 3), see `stacked_chains`
        arrays = coupling[:, indices.ravel()], np.moveaxis(stacked, 1, 0), np.moveaxis(p_PJ, 1, 0), p_tip
        kinematics.constants[key] = [torch.tensor(np.ascontiguousarray(array)).to(q) for array in arrays]
    coupling, *constants = kinematics.constants[key]
    angles = (q @ coupling).reshape(-1, len(kinematics.fingers), len(constants[0])).transpose(0, 1)
    points = _Tips.apply(angles, *constants)
    return points.transpose(0, 1).reshape(*q.shape[:-1], len(kinematics.fingers), 3)


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
            # The parts of R_PJ Rot(a, θ) p, see `fingertips`.
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


def constant(array: ArrayLike) -> torch.nn.Buffer:
    """Returns a constant of a module, as float32."""
    return torch.nn.Buffer(torch.tensor(np.asarray(array), dtype=torch.float32))
