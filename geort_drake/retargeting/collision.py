"""Computes gaps between the collision shapes of a hand, batched and differentiable in torch.

Shapes are boxes and spheres. The gap of two shapes is their largest separation over the face normals and edge
products of the boxes (separating-axis theorem: Gottschalk et al. 1996, "OBBTree") and over the direction from
the first box to the second shape's centre. The gap is negative if and only if the shapes overlap, exact if
one is a sphere, and never more than the true distance. A pair may have a correction, which is added.
"""

import copy

import numpy as np
import torch
from numpy.typing import ArrayLike

from geort_drake.hands.kinematics import CollisionShapes, HandKinematics
from geort_drake.retargeting.rotations import cross_matrices

__all__ = ["CollisionGaps", "CollisionShapes", "box_gap"]
_CHUNK = 1000


class CollisionGaps:
    """Computes gaps between the shapes of a hand at joint angles, in torch with float32.

    Args:
        kinematics, shapes: kinematics and collision shapes of the hand.
    """

    def __init__(self, kinematics: HandKinematics, shapes: CollisionShapes):
        def constant(array: ArrayLike) -> torch.Tensor:
            return torch.tensor(np.asarray(array), dtype=torch.float32)

        kinematics, coupling = kinematics.uncoupled()
        self._coupling = constant(coupling.T) if coupling.shape[0] > coupling.shape[1] else None
        chains = kinematics.fingers
        k = max(len(chain.joint_names) for chain in chains)
        X = np.tile(np.eye(4), (len(chains), k, 1, 1))
        axes, index = np.zeros((len(chains), k, 3)), np.zeros((len(chains), k), dtype=int)
        for row, chain in enumerate(chains):
            count = len(chain.joint_names)
            # A missing joint has no axis, so it is fixed.
            X[row, :count], axes[row, :count] = chain.X_PJ, chain.axes
            index[row, :count] = chain.joint_indices
        K = cross_matrices(axes)
        self._offset, self._turn = constant(X[..., :3, 3]), constant(X[..., :3, :3])
        self._K, self._K2 = constant(K), constant(K @ K)
        self._index = torch.tensor(index)
        # Frames are numbered by finger, base to tip; the last one is the hand base.
        number = {-1: len(chains) * k}
        for row, chain in enumerate(chains):
            number.update({joint: row * k + j for j, joint in enumerate(chain.joint_indices)})
        frames = [number[int(joint)] for joint in shapes.joint]
        self._frame = torch.tensor(frames, dtype=torch.long)
        self._R_JS, self._p_JS = constant(shapes.X_JS[:, :3, :3]), constant(shapes.X_JS[:, :3, 3])
        self._half, self._radius = constant(shapes.half), constant(shapes.radius)
        self._reach = torch.linalg.vector_norm(self._half, dim=1) + self._radius
        self.pairs = torch.tensor(np.asarray(shapes.pairs, dtype=int).reshape(-1, 2))
        self._correction = constant(np.broadcast_to(shapes.correction, len(self.pairs)))

    def to(self, device: torch.device) -> "CollisionGaps":
        """Returns a copy on another device."""
        moved = copy.copy(self)
        for name, value in vars(self).items():
            if isinstance(value, torch.Tensor):
                setattr(moved, name, value.to(device))
        return moved

    def keep_pairs_that_meet(self, q: torch.Tensor, margin: float) -> None:
        """Drops pairs that never come closer than `margin`, m, at joint angles q (N, n), rad."""
        met = torch.zeros(len(self.pairs), dtype=torch.bool, device=q.device)
        with torch.no_grad():
            for part in q.split(_CHUNK):
                _, pair, gap = self.near(part, margin)
                met[pair[gap < margin]] = True
        self.pairs, self._correction = self.pairs[met], self._correction[met]

    def poses(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Computes R_BS (N, S, 3, 3) and p_BS (N, S, 3), m, of the shapes at joint angles q (N, n), rad."""
        N, (fingers, k) = len(q), self._index.shape
        if self._coupling is not None:
            q = q @ self._coupling
        theta = q[:, self._index.reshape(-1)].reshape(N, fingers, k, 1, 1)
        eye = torch.eye(3, device=q.device)
        turned = self._turn @ (eye + torch.sin(theta) * self._K + (1 - torch.cos(theta)) * self._K2)
        R, p = [turned[:, :, 0]], [self._offset[:, 0].expand(N, -1, -1)]
        for j in range(1, k):
            p.append(p[-1] + (R[-1] @ self._offset[:, j, :, None])[..., 0])
            R.append(R[-1] @ turned[:, :, j])
        base = eye.expand(N, 1, 3, 3)
        R_BJ = torch.cat([torch.stack(R, dim=2).reshape(N, -1, 3, 3), base], dim=1)[:, self._frame]
        p_BJ = torch.cat([torch.stack(p, dim=2).reshape(N, -1, 3), q.new_zeros(N, 1, 3)], dim=1)
        p_BJ = p_BJ[:, self._frame]
        return R_BJ @ self._R_JS, p_BJ + (R_BJ @ self._p_JS[..., None])[..., 0]

    def near(self, q: torch.Tensor, margin: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Finds all pairs that may be closer than `margin`, m; returns rows of q, pairs, gaps (M,)."""
        R, p = self.poses(q)
        a, b = self.pairs.T
        with torch.no_grad():
            reach = self._reach[a] + self._reach[b] + margin - self._correction
            row, pair = torch.nonzero((p[:, a] - p[:, b]).square().sum(-1) < reach**2, as_tuple=True)
        return row, pair, self._gaps(R, p, row, pair)

    def least(self, q: torch.Tensor, margin: float) -> torch.Tensor:
        """Returns the smallest gap (N,), m, at joint angles q (N, n), rad, or `margin` if that is less."""
        result = []
        with torch.no_grad():
            for part in q.split(_CHUNK):
                row, _, gap = self.near(part, margin)
                least = torch.full((len(part),), margin, device=q.device)
                result.append(least.scatter_reduce(0, row, gap, "amin"))
        return torch.cat(result)

    def loss(
        self, q: torch.Tensor, row: torch.Tensor, pair: torch.Tensor, margin: float, scale: float
    ) -> torch.Tensor:
        """Computes the mean over q (N, n) of the sum of max(0, margin − gap) / scale over the given pairs.

        Args:
            q: (N, n) joint angles, rad.
            row, pair: (M,) rows of q and numbers of pairs, from `near`.
            margin, scale: lengths, m.
        """
        # Only rows with near pairs need gradients.
        rows, row = torch.unique(row, return_inverse=True)
        if len(rows) == 0:
            return 0.0 * q.sum()
        gap = self._gaps(*self.poses(q[rows]), row, pair)
        return torch.relu(margin - gap).sum() / (scale * len(q))

    def _gaps(self, R: torch.Tensor, p: torch.Tensor, row: torch.Tensor, pair: torch.Tensor) -> torch.Tensor:
        """Returns the gaps (M,), m, of the pairs numbered `pair` at the poses of `row`."""
        a, b = self.pairs[pair].T
        R_A, R_B, p_AB = R[row, a], R[row, b], p[row, b] - p[row, a]
        gap = box_gap(R_A, R_B, p_AB, self._half[a], self._half[b])
        return gap - self._radius[a] - self._radius[b] + self._correction[pair]


def box_gap(
    R_A: torch.Tensor, R_B: torch.Tensor, p_AB: torch.Tensor, a: torch.Tensor, b: torch.Tensor
) -> torch.Tensor:
    """Computes the largest separation (M,), m, of boxes A and B; see the module.

    Args:
        R_A, R_B: (M, 3, 3) orientations of the boxes in a common frame.
        p_AB: (M, 3) vector from the centre of A to that of B in the common frame, m.
        a, b: (M, 3) half edges, m; zero for a point.
    """
    R = R_A.transpose(1, 2) @ R_B
    t = (R_A * p_AB[:, :, None]).sum(1)  # in the frame of A
    s = (R_B * p_AB[:, :, None]).sum(1)  # in the frame of B
    size = R.abs()
    faces_a = t.abs() - a - (size * b[:, None]).sum(2)
    faces_b = s.abs() - b - (size * a[:, :, None]).sum(1)
    # Axes L = A_i × B_j: |t · L| and both boxes' extents along L, divided by its length sqrt(1 − R_ij²).
    along = (_down(t)[:, :, None] * _up(R) - _up(t)[:, :, None] * _down(R)).abs()
    extent = _up(a)[:, :, None] * _down(size) + _down(a)[:, :, None] * _up(size)
    size = size.mT
    extent = extent + (_up(b)[:, :, None] * _down(size) + _down(b)[:, :, None] * _up(size)).mT
    length = torch.sqrt(torch.clamp(1.0 - R.square(), min=1e-4))
    edges = torch.where(R.square() > 1.0 - 1e-3, -1.0, (along - extent) / length).flatten(1)
    # The axis from the nearest point of A to B's centre; it has no direction if the centre is inside A.
    outside = t - torch.minimum(torch.maximum(t, -a), a)
    distance = torch.sqrt(outside.square().sum(1) + 1e-12)
    axis = outside / distance[:, None]
    reach = (b * (axis[:, None] @ R)[:, 0].abs()).sum(1)
    towards = torch.where(distance > 1e-5, distance - reach, -1.0)
    return torch.cat([faces_a, faces_b, edges, towards[:, None]], dim=1).amax(1)


def _up(x: torch.Tensor) -> torch.Tensor:
    """Shifts the components of (M, 3, ...) cyclically to the next axis."""
    return x.roll(-1, 1)


def _down(x: torch.Tensor) -> torch.Tensor:
    """Shifts the components of (M, 3, ...) cyclically to the previous axis."""
    return x.roll(1, 1)
