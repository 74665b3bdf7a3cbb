"""Known affine maps from human to robot fingertips, to calibrate the simulated person.

They are not methods under test: gain, rotation and offset are given, so their effect on a grasp is known
beforehand, and the person's parameters can be chosen without looking at a method.
"""

from collections.abc import Sequence

import numpy as np

from geort_drake.hands.hand import Hand


class AffineMap:
    """Moves each robot fingertip by gain · R times the human fingertip's motion, by inverse kinematics.

    p_BF = p_BF0 + offset + gain · R_BH · (p_HF − p_HF0), where p_BF0 is the robot's default pose and p_HF0
    the human's rest. Each call starts from the last call's joint positions (damped least squares within the
    joint limits); `reset` returns to the default pose.

    Args:
        hand: the robot hand.
        p_HF_rest: (F, 3) human fingertips that correspond to the default pose, in the hand's finger order, m.
        gain: robot motion per human motion.
        R_BH: (3, 3) rotation of the motion's direction.
        offset: (3,) offset of every robot fingertip, m.
    """

    def __init__(
        self,
        hand: Hand,
        p_HF_rest: np.ndarray,
        gain: float = 1.0,
        R_BH: np.ndarray | None = None,
        offset: Sequence[float] = (0.0, 0.0, 0.0),
    ):
        self.joint_names = list(hand.joint_names)
        self.finger_names = list(hand.finger_names)
        self._hand = hand
        self._keypoints = [finger.human_keypoint for finger in hand.description.fingers]
        self._p_HF_rest = np.asarray(p_HF_rest, float)
        self._G = gain * (np.eye(3) if R_BH is None else np.asarray(R_BH, float))
        self._p_BF_rest = hand.fingertips(hand.default_position) + np.asarray(offset, float)
        # Columns of the joint vector that belong to each finger.
        ends = np.cumsum([len(finger.joints) for finger in hand.description.fingers])
        self._columns = [np.arange(*pair) for pair in zip([0, *ends[:-1]], ends, strict=True)]
        self.reset()

    def reset(self) -> None:
        """Forgets the last call."""
        self._q = self._hand.default_position.copy()

    def target(self, p_HF: np.ndarray) -> np.ndarray:
        """Returns target positions of the robot's fingertips, (F, 3) m in B, reachable or not."""
        return self._p_BF_rest + (np.asarray(p_HF, float) - self._p_HF_rest) @ self._G.T

    def __call__(self, p_H: np.ndarray) -> np.ndarray:
        """Returns joint positions (n,), rad, for keypoints (21, 3) or fingertips (F, 3), m in H."""
        p_H = np.asarray(p_H, float)
        target = self.target(p_H[self._keypoints] if len(p_H) == 21 else p_H)
        q, error = self._solve(target, self._q, 3)
        # A finger that is folded the wrong way cannot recover by small steps, so it starts over.
        stuck = error > 0.03
        if stuck.any():
            again, error_again = self._solve(target, self._hand.default_position, 30)
            for finger in np.flatnonzero(stuck & (error_again < error - 0.01)):
                q[self._columns[finger]] = again[self._columns[finger]]
        self._q = q
        return q.copy()

    def _solve(self, target: np.ndarray, q: np.ndarray, iterations: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns joint positions near q with the fingertips near `target`, and remaining errors (F,), m."""
        q = q.copy()
        for _ in range(iterations):
            p_BF, jacobians = self._linearise(q)
            for columns, J, error in zip(self._columns, jacobians, target - p_BF, strict=True):
                step = J.T @ np.linalg.solve(J @ J.T + 1e-5 * np.eye(3), error)
                q[columns] += np.clip(step, -0.3, 0.3)
            q = np.clip(q, self._hand.lower, self._hand.upper)
        return q, np.linalg.norm(target - self._hand.fingertips(q), axis=1)

    def _linearise(self, q: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """Returns fingertips (F, 3) at q, m, and each one's Jacobian (3, k) by its own finger's joints."""
        step = 1e-5
        deepest = max(len(columns) for columns in self._columns)
        # No joint moves two fingertips, so the k-th joints of all fingers are moved at once.
        moved = np.tile(q, (deepest + 1, 1))
        for columns in self._columns:
            for k, column in enumerate(columns):
                moved[k + 1, column] += step
        p = self._hand.fingertips(moved)
        slopes = (p[1:] - p[0]) / step
        return p[0], [slopes[: len(columns), f].T for f, columns in enumerate(self._columns)]
