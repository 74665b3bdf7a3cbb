"""Exact forward kinematics of a hand in torch, batched and differentiable: fingertips, and joint frames.

Fingers are serial chains of revolute joints from the hand base B; joints may follow others of the same
finger. For the fingertips, each chain transforms its tip point from joint to joint towards the base, so a
joint costs one product of a constant 9×3 matrix with a vector.
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike

from geort_drake.hands.kinematics import HandKinematics
from geort_drake.retargeting.numpy_kinematics import StackedChains


def fingertips(kinematics: HandKinematics, q: torch.Tensor) -> torch.Tensor:
    """Computes fingertip points p_BF (..., F, 3), m, at joint angles q (..., n), rad.

    Differentiable once, with the dtype and device of q; angles may exceed the limits.
    """
    n = len(kinematics.joint_names)
    if q.shape[-1] != n:
        raise ValueError(f"q must end with {n} joint angles, it has shape {tuple(q.shape)}")
    key = q.dtype, q.device
    if key not in kinematics.constants:
        kinematics.constants[key] = _Chains(kinematics, *key)
    points = kinematics.constants[key].points(q.reshape(-1, n))
    return points.transpose(0, 1).reshape(*q.shape[:-1], len(kinematics.fingers), 3)


class _Chains:
    """Constants of all fingers in a batch; shorter fingers get fixed joints at their base."""

    def __init__(self, kinematics: HandKinematics, dtype: torch.dtype, device: torch.device):
        R, p_PJ, K, p_tip, indices, coupling = StackedChains.of(kinematics)
        stacked = np.concatenate([R, R @ K, R @ K @ K], axis=-2)  # (F, k, 9, 3), see `StackedChains`

        def constant(array: np.ndarray) -> torch.Tensor:
            return torch.tensor(np.ascontiguousarray(array), dtype=dtype, device=device)

        self.matrices = constant(np.moveaxis(stacked, 1, 0))
        self.offsets = constant(np.moveaxis(p_PJ, 1, 0))
        self.coupling = None if coupling is None else constant(coupling)
        self.p_tip = constant(p_tip)
        # The angle of a fixed joint has no effect.
        self.indices = torch.tensor(np.maximum(indices.ravel(), 0), device=device)

    def points(self, q: torch.Tensor) -> torch.Tensor:
        """Computes fingertip points (F, N, 3) in B, m, at joint angles q (N, n), rad."""
        fingers = self.p_tip.shape[0]
        if self.coupling is not None:
            q = q @ self.coupling
        angles = q.index_select(1, self.indices).reshape(len(q), fingers, -1).transpose(0, 1)
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


class JointFrames(torch.nn.Module):
    """Computes the poses of all joints' moving frames, in float32.

    Attributes:
        number: index of a joint, among those of `HandKinematics.uncoupled()`, → number of its frame in the
            results; −1 → that of the base B.
    """

    turn: torch.Tensor
    offset: torch.Tensor
    K: torch.Tensor
    K2: torch.Tensor
    coupling: torch.Tensor

    def __init__(self, kinematics: HandKinematics):
        super().__init__()
        R, p_PJ, K, _, indices, coupling = StackedChains.of(kinematics)
        followers = {} if coupling is None else {"coupling": coupling}
        add_buffers(self, turn=R, offset=p_PJ[..., 0], K=K, K2=K @ K, **followers)
        self._has_followers = coupling is not None
        self._joints = np.maximum(indices.ravel(), 0).tolist()  # the angle of a fixed joint has no effect
        frames = enumerate(indices.ravel().tolist())
        self.number = {joint: frame for frame, joint in frames if joint >= 0} | {-1: indices.size}

    def forward(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Returns R_BJ (N, M, 3, 3) and p_BJ (N, M, 3), m, of M frames at joint angles q (N, n), rad."""
        N, (fingers, k) = len(q), self.turn.shape[:2]
        if self._has_followers:
            q = q @ self.coupling
        theta = q[:, self._joints].reshape(N, fingers, k, 1, 1)
        eye = torch.eye(3, device=q.device)
        turned = self.turn @ (eye + torch.sin(theta) * self.K + (1 - torch.cos(theta)) * self.K2)
        R, p = [turned[:, :, 0]], [self.offset[:, 0].expand(N, -1, -1)]
        for j in range(1, k):
            p.append(p[-1] + (R[-1] @ self.offset[:, j, :, None])[..., 0])
            R.append(R[-1] @ turned[:, :, j])
        base = eye.expand(N, 1, 3, 3)
        R_BJ = torch.cat([torch.stack(R, dim=2).reshape(N, -1, 3, 3), base], dim=1)
        return R_BJ, torch.cat([torch.stack(p, dim=2).reshape(N, -1, 3), q.new_zeros(N, 1, 3)], dim=1)


def add_buffers(module: torch.nn.Module, **arrays: ArrayLike) -> None:
    """Adds constants to a module, as float32."""
    for name, array in arrays.items():
        module.register_buffer(name, torch.tensor(np.asarray(array), dtype=torch.float32))
