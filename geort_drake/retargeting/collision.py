"""Computes gaps between the collision shapes of a hand, batched and differentiable in torch.

Shapes are boxes and spheres. The gap of two shapes is their largest separation over the face normals and edge
products of the boxes (separating-axis theorem: Gottschalk et al. 1996, "OBBTree") and over the direction from
the first box to the second shape's centre. The gap is negative if and only if the shapes overlap, exact if
one is a sphere, and never more than the true distance. A pair may have a correction, which is added.
"""

import numpy as np
import torch

from geort_drake.hands.kinematics import CollisionShapes, HandKinematics
from geort_drake.retargeting.kinematics import JointFrames, add_buffers

_CHUNK = 1000


class CollisionGaps(torch.nn.Module):
    """Computes gaps between the shapes of a hand at joint angles, in float32.

    Args:
        kinematics, shapes: kinematics and collision shapes of the hand.

    Attributes:
        pairs: (P, 2) numbers of the shapes whose gaps are computed.
    """

    R_JS: torch.Tensor
    p_JS: torch.Tensor
    half_edges: torch.Tensor
    radius: torch.Tensor
    correction: torch.Tensor
    pairs: torch.Tensor
    reach: torch.Tensor

    def __init__(self, kinematics: HandKinematics, shapes: CollisionShapes):
        super().__init__()
        self._joint_frames = JointFrames(kinematics)
        self._frame = [self._joint_frames.number[int(joint)] for joint in shapes.joint]
        pairs = np.asarray(shapes.pairs, dtype=int).reshape(-1, 2)
        add_buffers(
            self,
            R_JS=shapes.X_JS[:, :3, :3],
            p_JS=shapes.X_JS[:, :3, 3],
            half_edges=shapes.half,
            radius=shapes.radius,
            correction=np.broadcast_to(shapes.correction, len(pairs)),
        )
        self.register_buffer("pairs", torch.tensor(pairs))
        self.register_buffer("reach", torch.linalg.vector_norm(self.half_edges, dim=1) + self.radius)

    def keep_pairs_that_meet(self, q: torch.Tensor, margin: float) -> None:
        """Drops pairs that never come closer than `margin`, m, at joint angles q (N, n), rad."""
        met = torch.zeros(len(self.pairs), dtype=torch.bool, device=q.device)
        with torch.no_grad():
            for part in q.split(_CHUNK):
                _, pair, gap = self.near(part, margin)
                met[pair[gap < margin]] = True
        self.pairs, self.correction = self.pairs[met], self.correction[met]

    def poses(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Computes R_BS (N, S, 3, 3) and p_BS (N, S, 3), m, of the shapes at joint angles q (N, n), rad."""
        R_BJ, p_BJ = (each[:, self._frame] for each in self._joint_frames(q))
        return R_BJ @ self.R_JS, p_BJ + (R_BJ @ self.p_JS[..., None])[..., 0]

    def near(self, q: torch.Tensor, margin: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Finds all pairs that may be closer than `margin`, m; returns rows of q, pairs, gaps (M,)."""
        R, p = self.poses(q)
        a, b = self.pairs.T
        with torch.no_grad():
            reach = self.reach[a] + self.reach[b] + margin - self.correction
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
        gap = box_gap(R_A, R_B, p_AB, self.half_edges[a], self.half_edges[b])
        return gap - self.radius[a] - self.radius[b] + self.correction[pair]


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
