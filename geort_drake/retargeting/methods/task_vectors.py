"""Solves Eq. 1 of the GeoRT paper at run time: joint angles whose task vectors match the scaled human ones.

min over q of  Σ_i w_i h(|v_R^i(q) − v*^i|) / V  +  norm_delta · |q − q_previous|²,  lower ≤ q ≤ upper

with h the Huber function of PyTorch's SmoothL1 (x² / 2δ below δ, x − δ/2 above). A task vector goes from
the wrist or a fingertip to a fingertip. A damped Gauss–Newton method on the free joints needs a few steps and
solves many frames at once.
"""

import numpy as np

from geort_drake.retargeting.numpy_kinematics import NumpyKinematics

WRIST = -1  # origin of a task vector that starts at the wrist
TOLERANCE, ITERATIONS = 1e-4, 60  # rad, largest last step; maximum number of steps


class TaskVectors:
    """Vectors between the wrist and fingertips of a hand, and their inverse kinematics.

    Attributes:
        pairs: V pairs (origin, tip) of finger numbers; the origin may be WRIST.
    """

    def __init__(
        self,
        kinematics: NumpyKinematics,
        pairs: list[tuple[int, int]],
        huber_delta: float,
        norm_delta: float,
    ):
        """Takes the equation's δ as `huber_delta`, m, and its `norm_delta`, 1/rad²."""
        self.kinematics, self.pairs = kinematics, pairs
        self._huber_delta, self._norm_delta = huber_delta, norm_delta
        # v = difference · tips − origin
        self._difference = np.zeros((len(pairs), len(kinematics.finger_names)))
        self._origin = np.zeros((len(pairs), 3))
        for row, (origin, tip) in enumerate(pairs):
            self._difference[row, tip] = 1.0
            if origin == WRIST:
                self._origin[row] = kinematics.p_BW
            else:
                self._difference[row, origin] = -1.0

    def human(self, p_HF: np.ndarray) -> np.ndarray:
        """Returns the person's task vectors (N, V, 3), m, for fingertips (N, F, 3) in the wrist frame, m."""
        return self._difference @ p_HF

    def solve(
        self,
        targets: np.ndarray,
        weights: np.ndarray,
        start: np.ndarray,
        previous: np.ndarray | None,
    ) -> np.ndarray:
        """Finds joint angles (N, n), rad, that minimise the objective of each of N frames.

        Args:
            targets: (N, V, 3) target task vectors, m.
            weights: (N, V) weights of the vectors.
            start: (N, n) initial joint angles inside the limits, rad.
            previous: (N, n) joint angles of the regulariser, rad; None omits it.
        """
        lower, upper = self.kinematics.lower, self.kinematics.upper
        q = np.clip(start, lower, upper)
        rows = np.arange(len(q))  # unfinished frames
        damping = np.full(len(q), 1e-3)
        loss, gradient, H = self.objective(q, targets, weights, previous)
        for _ in range(ITERATIONS):
            # Joints that the gradient presses against a limit are fixed.
            free = ~(((q[rows] <= lower) & (gradient > 0)) | ((q[rows] >= upper) & (gradient < 0)))
            # Damping relative to the mean curvature leaves redundant directions unchanged.
            scale = np.einsum("nii->n", H) / H.shape[-1] + 1e-12
            A = H * (free[:, :, None] & free[:, None, :])
            diagonal = np.einsum("nii->ni", A)
            diagonal += np.where(free, (damping[rows] * scale)[:, None], 1.0)
            step = np.linalg.solve(A, -(gradient * free)[..., None])[..., 0]
            trial = np.clip(q[rows] + step, lower, upper)
            of = None if previous is None else previous[rows]
            new = self.objective(trial, targets[rows], weights[rows], of)
            better = new[0] <= loss
            moved = np.abs(trial - q[rows]).max(axis=1)
            q[rows[better]] = trial[better]
            damping[rows] = np.clip(damping[rows] * np.where(better, 0.2, 10.0), 1e-6, 1e6)
            loss = np.where(better, new[0], loss)
            gradient = np.where(better[:, None], new[1], gradient)
            H = np.where(better[:, None, None], new[2], H)
            going = moved > TOLERANCE
            if not going.any():
                break
            rows, loss, gradient, H = rows[going], loss[going], gradient[going], H[going]
        return q

    def objective(
        self, q: np.ndarray, targets: np.ndarray, weights: np.ndarray, previous: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns loss (N,), gradient (N, n) and Gauss–Newton Hessian (N, n, n) at q (N, n), rad.
        Other arguments are those of `solve`.
        """
        tips, J = self.kinematics.fingertips_and_jacobians(q)
        count, fingers, _, n = J.shape
        residual = self._difference @ tips - self._origin - targets
        J = (self._difference @ J.reshape(count, fingers, 3 * n)).reshape(count, -1, n)
        distance = np.sqrt((residual**2).sum(-1))
        delta = self._huber_delta
        huber = np.where(distance < delta, 0.5 * distance**2 / delta, distance - 0.5 * delta)
        weights = weights / len(self.pairs)
        loss = (weights * huber).sum(-1)
        # h'(d)/d is the weight with which half the squared residual has the same gradient.
        w = np.repeat(weights / np.maximum(distance, delta), 3, axis=-1)
        weighted = J * w[..., None]
        gradient = (residual.reshape(count, 1, -1) @ weighted)[:, 0]
        H = np.swapaxes(J, -1, -2) @ weighted
        if previous is not None:
            away = q - previous
            loss = loss + self._norm_delta * (away**2).sum(-1)
            gradient = gradient + 2.0 * self._norm_delta * away
            H += 2.0 * self._norm_delta * np.eye(n)
        return loss, gradient, H
