"""Exact fingertip kinematics and Jacobians of a hand in NumPy, batched.

This is the counterpart of `HandKinematics` for methods that optimise at run time without torch.
"""

import numpy as np

from geort_drake.hands.kinematics import HandKinematics
from geort_drake.retargeting.rotations import cross_matrices

# Joint limits of many turns are mistakes and could cause overflow.
MAX_ANGLE = 100.0  # rad


class NumpyKinematics:
    """Fingertips p_BF and their Jacobians of serial fingers with revolute joints.

    Attributes:
        finger_names: F names.
        joint_names: n names in the order of q.
        lower, upper: (n,) joint limits, rad.
        tip_radius: radius of the fingertip spheres, m.
        p_BW: (3,) the hand's wrist in its base, m.
    """

    def __init__(self, kinematics: HandKinematics):
        """Takes the hand's kinematics, from `Hand.kinematics()` for example."""
        self.finger_names, self.joint_names = kinematics.finger_names, kinematics.joint_names
        self.lower, self.upper = kinematics.lower, kinematics.upper
        self.tip_radius, self.p_BW = kinematics.tip_radius, kinematics.p_BW
        free, coupling = kinematics.uncoupled()
        # Angles of all N joints, followers last, per q: (N, n); None without followers.
        n = len(coupling)
        self._coupling = coupling if n > len(self.joint_names) else None
        fingers, k = len(free.fingers), max(len(finger.joint_indices) for finger in free.fingers)
        # Shorter fingers get fixed joints at their base, which read the unused angle n.
        indices = np.full((fingers, k), n)
        X = np.tile(np.eye(4), (fingers, k, 1, 1))
        axes = np.zeros((fingers, k, 3))
        for f, finger in enumerate(free.fingers):
            own = slice(k - len(finger.joint_indices), k)
            indices[f, own], X[f, own], axes[f, own] = finger.joint_indices, finger.X_PJ, finger.axes
        K = cross_matrices(axes)
        # Rodrigues: R_PJ Rot(a, θ) = R_PJ + sin θ · R_PJ K + (1 − cos θ) · R_PJ K²
        self._R = X[..., :3, :3]
        self._RK = self._R @ K
        self._RKK = self._RK @ K
        self._offset = X[..., :3, 3:]
        self._p_tip = np.stack([finger.p_tip for finger in free.fingers])[:, :, None]
        self._indices = indices

    def fingertips(self, q: np.ndarray) -> np.ndarray:
        """Computes fingertip points p_BF (N, F, 3), m, at joint angles q (N, n), rad."""
        return self.fingertips_and_jacobians(q)[0]

    def fingertips_and_jacobians(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Computes p_BF (N, F, 3), m, and ∂p_BF/∂q (N, F, 3, n), m/rad, at joint angles q (N, n), rad."""
        if self._coupling is not None:
            q = q @ self._coupling.T
        count, n = q.shape
        fingers, k = self._indices.shape
        angles = np.concatenate([q, np.zeros((count, 1))], axis=1)[:, self._indices][..., None, None]
        sine, cosine = np.sin(angles), np.cos(angles)
        M = self._R + sine * self._RK + (1.0 - cosine) * self._RKK
        dM = cosine * self._RK + sine * self._RKK
        p = self._p_tip
        J = np.empty((count, fingers, 3, k))
        # From the tip to the base: each joint rotates the point and the columns of the joints beyond it.
        for j in reversed(range(k)):
            M_j = M[:, :, j]
            if j + 1 < k:
                J[..., j + 1 :] = M_j @ J[..., j + 1 :]
            J[..., j : j + 1] = dM[:, :, j] @ p
            p = M_j @ p + self._offset[:, j]
        full = np.zeros((count, fingers, n + 1, 3))
        full[:, np.arange(fingers)[:, None], self._indices] = np.swapaxes(J, -1, -2)
        J = np.swapaxes(full[:, :, :n], -1, -2)
        return p[..., 0], J if self._coupling is None else J @ self._coupling
