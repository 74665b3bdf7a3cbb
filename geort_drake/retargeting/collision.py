"""Computes gaps between the collision shapes of a hand, batched and differentiable in torch.

The gap of two convex shapes is their largest separation over the `lattice_directions` of both. A separation
is never more than the true distance, or than minus the depth of the overlap. The gap falls short of these by
about 0.2 mm between links, and by nothing where a face of a box decides.
"""

import numpy as np
import torch

from geort_drake.hands.kinematics import CollisionShapes, HandKinematics, lattice_directions
from geort_drake.retargeting.kinematics import constant
from geort_drake.retargeting.numpy_kinematics import stacked_chains

_CHUNK = 500  # hands
_DIRECTIONS = 8  # that are examined of each shape; all 98 find the same overlaps


class CollisionGaps(torch.nn.Module):
    """Computes gaps between the shapes of a hand at joint angles, in float32.

    Args:
        kinematics, shapes: kinematics and collision shapes of the hand.

    Attributes:
        pairs: (P, 2) numbers of the shapes whose gaps are computed.
    """

    def __init__(self, kinematics: HandKinematics, shapes: CollisionShapes):
        super().__init__()
        R, p_PJ, K, _, indices, coupling = stacked_chains(kinematics)
        self.turn, self.offset, self.K, self.K2 = map(constant, (R, p_PJ[..., 0], K, K @ K))
        self.coupling = constant(coupling[:, indices.ravel()])  # a fixed joint's angle has no effect
        # Numbers of the shapes' joint frames; the last one is the base B.
        frames = {joint: frame for frame, joint in enumerate(indices.ravel())} | {-1: indices.size}
        self._frame = [frames[joint] for joint in shapes.joint]
        directions = lattice_directions()
        self.R_JS, self.p_JS = constant(shapes.X_JS[:, :3, :3]), constant(shapes.X_JS[:, :3, 3])
        self.vertices, self.radius = constant(shapes.vertices), constant(shapes.radius)
        self.directions = constant(directions)
        self.support = constant((shapes.vertices @ directions.T).max(axis=1))
        self.half_edges = constant(np.abs(shapes.vertices).max(axis=1))
        self.reach = constant(np.linalg.norm(shapes.vertices, axis=2).max(axis=1) + shapes.radius)
        pairs = np.asarray(shapes.pairs, dtype=int).reshape(-1, 2)
        self.pairs: torch.Tensor = torch.nn.Buffer(torch.tensor(pairs))

    def keep_pairs_that_meet(self, q: torch.Tensor, margin: float) -> None:
        """Drops pairs that never come closer than `margin`, m, at joint angles q (N, n), rad."""
        met = torch.zeros(len(self.pairs), dtype=torch.bool, device=q.device)
        with torch.no_grad():
            for part in q.split(_CHUNK):
                _, pair, gap = self.near(part, margin)
                met[pair[gap < margin]] = True
        self.pairs = self.pairs[met]

    def poses(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Computes R_BS (N, S, 3, 3) and p_BS (N, S, 3), m, of the shapes at joint angles q (N, n), rad."""
        N, (fingers, k) = len(q), self.turn.shape[:2]
        theta = (q @ self.coupling).reshape(N, fingers, k, 1, 1)
        eye = torch.eye(3, device=q.device)
        turned = self.turn @ (eye + torch.sin(theta) * self.K + (1 - torch.cos(theta)) * self.K2)
        R, p = [turned[:, :, 0]], [self.offset[:, 0].expand(N, -1, -1)]
        for j in range(1, k):
            p.append(p[-1] + (R[-1] @ self.offset[:, j, :, None])[..., 0])
            R.append(R[-1] @ turned[:, :, j])
        R_BJ = torch.cat([torch.stack(R, dim=2).reshape(N, -1, 3, 3), eye.expand(N, 1, 3, 3)], dim=1)
        p_BJ = torch.cat([torch.stack(p, dim=2).reshape(N, -1, 3), q.new_zeros(N, 1, 3)], dim=1)
        R_BJ, p_BJ = R_BJ[:, self._frame], p_BJ[:, self._frame]
        return R_BJ @ self.R_JS, p_BJ + (R_BJ @ self.p_JS[..., None])[..., 0]

    def near(self, q: torch.Tensor, margin: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Finds all pairs that may be closer than `margin`, m; returns rows of q, pairs, gaps (M,).

        Only the gaps are differentiable.
        """
        R, p = self.poses(q)
        a, b = self.pairs.T
        with torch.no_grad():
            reach = self.reach[a] + self.reach[b] + margin
            row, pair = torch.nonzero((p[:, a] - p[:, b]).square().sum(-1) < reach**2, as_tuple=True)
            near = self._box_gaps(R, p, row, pair) < margin
        row, pair = row[near], pair[near]
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

    def _box_gaps(
        self, R: torch.Tensor, p: torch.Tensor, row: torch.Tensor, pair: torch.Tensor
    ) -> torch.Tensor:
        """Returns lower bounds (M,), m, of the gaps: separations along the axes of the boxes about both."""
        a, b = self.pairs[pair].T
        R_A, R_B, p_AB = R[row, a], R[row, b], (p[row, b] - p[row, a])[:, :, None]
        half_a, half_b = self.half_edges[a, :, None], self.half_edges[b, :, None]
        size = (R_A.mT @ R_B).abs()
        by_a = (R_A.mT @ p_AB).abs() - half_a - size @ half_b
        by_b = (R_B.mT @ p_AB).abs() - half_b - size.mT @ half_a
        return torch.maximum(by_a, by_b).amax((1, 2)) - self.radius[a] - self.radius[b]

    def _gaps(self, R: torch.Tensor, p: torch.Tensor, row: torch.Tensor, pair: torch.Tensor) -> torch.Tensor:
        """Returns the gaps (M,), m, of the pairs numbered `pair` at the poses of `row`."""
        a, b = self.pairs[pair].T
        gaps = [
            self._separation(R[row, i], R[row, j], p[row, j] - p[row, i], i, j) for i, j in ((a, b), (b, a))
        ]
        return torch.maximum(*gaps) - self.radius[a] - self.radius[b]

    def _separation(
        self, R_BI: torch.Tensor, R_BJ: torch.Tensor, p_IJ_B: torch.Tensor, i: torch.Tensor, j: torch.Tensor
    ) -> torch.Tensor:
        """Returns the largest separation (M,), m, of shapes i and j (M,) over the directions of i."""
        R_IJ, p_IJ = R_BI.mT @ R_BJ, (R_BI.mT @ p_IJ_B[:, :, None])[..., 0]
        with torch.no_grad():
            beyond = p_IJ @ self.directions.T - self.support[i]
            # The box about j is enough to see which directions come into question.
            extent = ((self.directions @ R_IJ).abs() @ self.half_edges[j, :, None])[..., 0]
            chosen = (beyond - extent).topk(_DIRECTIONS, dim=1).indices
            towards = self.directions[chosen] @ R_IJ  # (M, K, 3) in the frame of j
            nearest = (towards @ self.vertices[j].mT).min(dim=2)
            best = (beyond.gather(1, chosen) + nearest.values).argmax(dim=1, keepdim=True)
            direction, vertex = chosen.gather(1, best)[:, 0], nearest.indices.gather(1, best)[:, 0]
        # By the envelope theorem, direction and vertex are constants of the derivative.
        p_I = p_IJ + (R_IJ @ self.vertices[j, vertex][:, :, None])[..., 0]
        return (p_I * self.directions[direction]).sum(1) - self.support[i, direction]
