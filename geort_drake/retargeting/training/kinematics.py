"""Exact forward kinematics of a hand's fingertips in torch, batched and differentiable.

Fingers are serial chains of revolute joints from the hand base B; joints may follow others of the same
finger. Each chain transforms its tip point from joint to joint towards the base, so a joint costs one product
of a constant 9×3 matrix with a vector.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch

from geort_drake.retargeting.rotations import cross_matrices


@dataclass(frozen=True)
class FingerChain:
    """One finger: a serial chain of revolute joints from the hand base B to the fingertip point.

    Attributes:
        name: name of the finger.
        joint_names: names of the k independent joints, base to tip.
        joint_indices: indices of these k joints in the hand's q.
        X_PJ: (m, 4, 4) pose, m, of each of the m ≥ k joint frames J in its parent's joint frame P (B for the
            first), at zero angle of the joint, or of the one that it follows.
        axes: (m, 3) unit rotation axes in J.
        p_tip: (3,) fingertip point in the last joint's moving frame, m.
        all_joint_names: names of all m joints, base to tip; by default `joint_names`.
        coupling: (m, k) rotation of each joint per rotation of the k joints; by default the identity.
    """

    name: str
    joint_names: tuple[str, ...]
    joint_indices: tuple[int, ...]
    X_PJ: np.ndarray
    axes: np.ndarray
    p_tip: np.ndarray
    all_joint_names: tuple[str, ...] = ()
    coupling: np.ndarray = None  # type: ignore[assignment]  # never None afterwards

    def __post_init__(self) -> None:
        object.__setattr__(self, "all_joint_names", tuple(self.all_joint_names or self.joint_names))
        if self.coupling is None:
            object.__setattr__(self, "coupling", np.eye(len(self.all_joint_names), len(self.joint_names)))
        for name in ("X_PJ", "axes", "p_tip", "coupling"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))


@dataclass(frozen=True)
class HandKinematics:
    """The fingers of a hand, with q in the order of `joint_names`.

    Attributes:
        fingers: the F chains.
        joint_names: names of the n joints in the order of q.
        lower, upper: (n,) joint limits, rad.
        tip_radius: radius of the fingertip spheres, m.
        p_BW: (3,) the hand's wrist in its base, m.
    """

    fingers: tuple[FingerChain, ...]
    joint_names: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    tip_radius: float
    p_BW: np.ndarray = field(default_factory=lambda: np.zeros(3))
    _constants: dict = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "fingers", tuple(self.fingers))
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        for name in ("lower", "upper", "p_BW"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))

    @property
    def finger_names(self) -> tuple[str, ...]:
        return tuple(finger.name for finger in self.fingers)

    def fingertips(self, q: torch.Tensor) -> torch.Tensor:
        """Computes fingertip points p_BF (..., F, 3), m, at joint angles q (..., n), rad.

        Differentiable once, with the dtype and device of q; angles may exceed the limits.
        """
        n = len(self.joint_names)
        if q.shape[-1] != n:
            raise ValueError(f"q must end with {n} joint angles, it has shape {tuple(q.shape)}")
        chains = self._chains(q.dtype, q.device)
        return chains.points(q.reshape(-1, n)).transpose(0, 1).reshape(*q.shape[:-1], len(self.fingers), 3)

    def mirrored(self) -> "HandKinematics":
        """Returns the mirror image in the xz-plane, whose fingertips are at (x, −y, z) for the same q.

        A left robot hand is mirrored to compare it with human hands, which are always stored as right hands.
        """
        M = np.diag([1.0, -1.0, 1.0, 1.0])
        fingers = [
            # A rotation axis is an axial vector, so its reflection changes sign.
            replace(f, X_PJ=M @ f.X_PJ @ M, axes=-f.axes @ M[:3, :3], p_tip=M[:3, :3] @ f.p_tip)
            for f in self.fingers
        ]
        return replace(self, fingers=tuple(fingers), p_BW=M[:3, :3] @ self.p_BW)

    def uncoupled(self) -> tuple["HandKinematics", np.ndarray]:
        """Returns the hand with independent joints in place of coupled ones.

        Returns:
            A hand with the n joints of this one, then the followers, N in total; and the matrix (N, n) from
            this hand's joint angles to those of that hand.
        """
        names = list(self.joint_names)
        rows = [*np.eye(len(names))]
        for finger in self.fingers:
            for name, row in zip(finger.all_joint_names, finger.coupling, strict=True):
                if name not in names:
                    names.append(name)
                    rows.append(np.zeros(len(self.joint_names)))
                    rows[-1][list(finger.joint_indices)] = row
        fingers = [
            replace(
                finger,
                joint_names=finger.all_joint_names,
                joint_indices=tuple(names.index(name) for name in finger.all_joint_names),
                coupling=np.eye(len(finger.all_joint_names)),
            )
            for finger in self.fingers
        ]
        matrix = np.array(rows)
        ends = matrix * self.lower, matrix * self.upper
        lower, upper = np.minimum(*ends).sum(1), np.maximum(*ends).sum(1)
        hand = replace(self, fingers=tuple(fingers), joint_names=tuple(names), lower=lower, upper=upper)
        return hand, matrix

    def _chains(self, dtype: torch.dtype, device: torch.device) -> "_Chains":
        if (dtype, device) not in self._constants:
            self._constants[dtype, device] = _Chains(self.fingers, dtype, device)
        return self._constants[dtype, device]


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
