"""Exact fingertip kinematics and Jacobians of a hand in NumPy, batched.

This is the counterpart of `HandKinematics` for methods that optimise at run time without torch.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from geort_drake.hands.kinematics import FingerChain, HandKinematics

MIRROR_TOLERANCE_M = 1e-3


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


def match_joints(hand: HandKinematics, mirrored: HandKinematics) -> tuple[np.ndarray, np.ndarray] | None:
    """Matches the joints of two hands of which one is the mirror image of the other.

    Joints correspond along each finger. At corresponding fractions of their ranges, both hands must have the
    same fingertips within `MIRROR_TOLERANCE_M`, at 100 random postures.

    Args:
        hand: kinematics of one hand.
        mirrored: kinematics of the other, mirrored; see `HandKinematics.mirrored`.

    Returns:
        Numbers (n,) of the joints of `hand` for those of `mirrored`, and their senses (n,), 1 or −1; with −1,
        one joint is at its upper limit where the other is at its lower. None if the hands differ.
    """
    if mirrored.finger_names != hand.finger_names or len(mirrored.joint_names) != len(hand.joint_names):
        return None
    rows, signs = np.zeros(len(hand.joint_names), dtype=int), np.ones(len(hand.joint_names))
    axes, others = (_axes_amid_limits(each) for each in (hand, mirrored))
    for chain, other in zip(hand.fingers, mirrored.fingers, strict=True):
        joints, theirs = list(chain.joint_indices), list(other.joint_indices)
        if len(joints) != len(theirs):
            return None
        rows[theirs] = joints
        signs[theirs] = np.where((axes[joints] * others[theirs]).sum(-1) < 0, -1.0, 1.0)
    fractions = np.random.default_rng(0).uniform(size=(100, len(rows)))
    mirrored_fractions = np.where(signs > 0, fractions[:, rows], 1.0 - fractions[:, rows])
    tips, mirrored_tips = (
        NumpyKinematics(each).fingertips(each.lower + part * (each.upper - each.lower))
        for each, part in ((hand, fractions), (mirrored, mirrored_fractions))
    )
    far = np.linalg.norm(tips - mirrored_tips, axis=-1).max()
    return (rows, signs) if far <= MIRROR_TOLERANCE_M else None


def _axes_amid_limits(hand: HandKinematics) -> np.ndarray:
    """Returns the unit axes (n, 3) of the joints in B, with all joints in the middle of their ranges."""
    chains, angles = hand.uncoupled()
    X_BJ = chains.joint_poses((angles @ (0.5 * (hand.lower + hand.upper)))[None])[0]
    axes = np.zeros((len(chains.joint_names), 3))
    for finger in chains.fingers:
        for joint, axis in zip(finger.joint_indices, finger.axes, strict=True):
            axes[joint] = X_BJ[joint, :3, :3] @ axis
    return axes[: len(hand.joint_names)]
