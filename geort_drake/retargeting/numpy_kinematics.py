"""Exact fingertip kinematics and Jacobians of a hand in NumPy, batched.

This is the counterpart of `HandKinematics` for methods that optimise at run time without torch.
"""

import numpy as np

from geort_drake.hands.kinematics import HandKinematics

MIRROR_TOLERANCE_M = 1e-3


def stacked_chains(kinematics: HandKinematics) -> tuple[np.ndarray, ...]:
    """Stacks the constants of F fingers; those with fewer than k joints get fixed ones at their base.

    Returns:
        R_PJ, p_PJ: (F, k, 3, 3) and (F, k, 3, 1) poses of the joints in their parents, at zero angle, m.
        K: (F, k, 3, 3) with K x = a × x for the axis a of each joint; zero for a fixed one. By Rodrigues,
            R_PJ Rot(a, θ) = R_PJ + sin θ · R_PJ K + (1 − cos θ) · R_PJ K².
        p_tip: (F, 3, 1) fingertip points in the last joints' moving frames, m.
        indices: (F, k) numbers of the joints among those of `HandKinematics.uncoupled()`; −1 for a fixed one.
        coupling: (n, N) such that q @ coupling are the angles of these N joints.
    """
    free, coupling = kinematics.uncoupled()
    F, k = len(free.fingers), max(len(finger.axes) for finger in free.fingers)
    X, K, indices = np.tile(np.eye(4), (F, k, 1, 1)), np.zeros((F, k, 3, 3)), np.full((F, k), -1)
    for row, finger in enumerate(free.fingers):
        first = k - len(finger.axes)
        X[row, first:], (x, y, z) = finger.X_PJ, finger.axes.T
        K[row, first:, 0, 1], K[row, first:, 0, 2], K[row, first:, 1, 2] = -z, y, -x
        indices[row, first:] = finger.joint_indices
    K -= np.swapaxes(K, -1, -2)
    p_tip = np.stack([finger.p_tip for finger in free.fingers])[:, :, None]
    return X[..., :3, :3], X[..., :3, 3:], K, p_tip, indices, coupling.T


class NumpyKinematics:
    """Fingertips p_BF and their Jacobians of serial fingers with revolute joints."""

    def __init__(self, kinematics: HandKinematics):
        """Takes the hand's kinematics, from `Hand.kinematics()` for example."""
        self._R, self._offset, K, self._p_tip, self._indices, coupling = stacked_chains(kinematics)
        self._coupling = coupling if len(coupling) < coupling.shape[1] else None  # None without followers
        self._RK = self._R @ K
        self._RKK = self._RK @ K

    def fingertips(self, q: np.ndarray) -> np.ndarray:
        """Computes fingertip points p_BF (N, F, 3), m, at joint angles q (N, n), rad."""
        return self.fingertips_and_jacobians(q)[0]

    def fingertips_and_jacobians(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Computes p_BF (N, F, 3), m, and ∂p_BF/∂q (N, F, 3, n), m/rad, at joint angles q (N, n), rad."""
        if self._coupling is not None:
            q = q @ self._coupling
        count, n = q.shape
        fingers, k = self._indices.shape
        # Fixed joints, of index −1, read an unused angle.
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
        return p[..., 0], J if self._coupling is None else J @ self._coupling.T


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
    models = NumpyKinematics(hand), NumpyKinematics(mirrored)
    middles = (0.5 * (each.lower + each.upper) for each in (hand, mirrored))
    # Corresponding joints move the fingertips to the same or to opposite sides.
    moves, others = (
        each.fingertips_and_jacobians(q[None])[1].sum((0, 1)).T
        for each, q in zip(models, middles, strict=True)
    )
    for chain, other in zip(hand.fingers, mirrored.fingers, strict=True):
        joints, theirs = list(chain.joint_indices), list(other.joint_indices)
        if len(joints) != len(theirs):
            return None
        rows[theirs] = joints
        signs[theirs] = np.where((moves[joints] * others[theirs]).sum(-1) < 0, -1.0, 1.0)
    fractions = np.random.default_rng(0).uniform(size=(100, len(rows)))
    mirrored_fractions = np.where(signs > 0, fractions[:, rows], 1.0 - fractions[:, rows])
    tips = models[0].fingertips(hand.lower + fractions * (hand.upper - hand.lower))
    mirrored_tips = models[1].fingertips(
        mirrored.lower + mirrored_fractions * (mirrored.upper - mirrored.lower)
    )
    far = np.linalg.norm(tips - mirrored_tips, axis=-1).max()
    return (rows, signs) if far <= MIRROR_TOLERANCE_M else None
