"""Exact fingertip kinematics and Jacobians of a hand in NumPy, batched.

This is the counterpart of `HandKinematics` for methods that optimise at run time without torch.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from geort_drake.hands.kinematics import FingerChain, HandKinematics


class StackedChains(NamedTuple):
    """The constants of F fingers as one batch; fingers with fewer than k joints get fixed ones at their base.

    Attributes:
        R_PJ, p_PJ: (F, k, 3, 3) and (F, k, 3, 1) poses of the joints in their parents, at zero angle, m.
        K: (F, k, 3, 3) with K x = a × x for the axis a of each joint; zero for a fixed one. By Rodrigues,
            R_PJ Rot(a, θ) = R_PJ + sin θ · R_PJ K + (1 − cos θ) · R_PJ K².
        p_tip: (F, 3, 1) fingertip points in the last joints' moving frames, m.
        spare: number of fixed joints of each finger.
    """

    R_PJ: np.ndarray
    p_PJ: np.ndarray
    K: np.ndarray
    p_tip: np.ndarray
    spare: list[int]

    @classmethod
    def of(cls, fingers: Sequence[FingerChain]) -> "StackedChains":
        k = max(len(finger.axes) for finger in fingers)
        X, K = np.tile(np.eye(4), (len(fingers), k, 1, 1)), np.zeros((len(fingers), k, 3, 3))
        spare = [k - len(finger.axes) for finger in fingers]
        for row, (finger, first) in enumerate(zip(fingers, spare, strict=True)):
            X[row, first:], (x, y, z) = finger.X_PJ, finger.axes.T
            K[row, first:, 0, 1], K[row, first:, 0, 2], K[row, first:, 1, 2] = -z, y, -x
        K -= np.swapaxes(K, -1, -2)
        p_tip = np.stack([finger.p_tip for finger in fingers])[:, :, None]
        return cls(X[..., :3, :3], X[..., :3, 3:], K, p_tip, spare)


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
        self._R, self._offset, K, self._p_tip, spare = StackedChains.of(free.fingers)
        self._RK = self._R @ K
        self._RKK = self._RK @ K
        # Fixed joints read the unused angle n.
        rows = zip(free.fingers, spare, strict=True)
        self._indices = np.array([[n] * fixed + [*finger.joint_indices] for finger, fixed in rows])

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
