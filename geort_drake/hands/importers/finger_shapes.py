"""Where a hand's fingers begin and point, and to which side they bend, from their joints' axes and limits."""

from dataclasses import dataclass, replace

import numpy as np

from geort_drake.hands.hand import Hand
from geort_drake.hands.kinematics import HandKinematics

# Joints bend a finger if their axes are parallel to that of its last joint up to this angle.
_PARALLEL = np.cos(np.deg2rad(35.0))
_STRETCH_GRID = 41
# A joint stays at its start where stretching lengthens the finger by less than this fraction.
_STRETCH_GAIN = 0.02


@dataclass(frozen=True)
class FingerShape:
    """A stretched finger in the frame of the hand base.

    Attributes:
        p_base: (3,) origin of the finger's first joint, m.
        p_knuckle: (3,) origin of the first joint that bends the finger, m.
        p_tip: (3,) the fingertip, m.
        p_middle: (3,) the fingertip where all joints are in the middle of their ranges, m.
        bend: (3,) sum over the bending joints of axis times angle from stretched to mid-range, rad.
        play: the sum of half the ranges of the bending joints, rad.
    """

    p_base: np.ndarray
    p_knuckle: np.ndarray
    p_tip: np.ndarray
    p_middle: np.ndarray
    bend: np.ndarray
    play: float

    @property
    def direction(self) -> np.ndarray:
        """(3,) unit vector along the finger."""
        return unit(self.p_tip - self.p_knuckle)

    @property
    def length(self) -> float:
        """Distance of the fingertip from the first joint, m."""
        return float(np.linalg.norm(self.p_tip - self.p_base))

    @property
    def bending(self) -> np.ndarray:
        """(3,) direction in which the tip moves when the finger bends, longer the more it bends."""
        return np.cross(self.bend, self.direction)


def finger_shapes(hand: Hand, start: np.ndarray) -> list[FingerShape]:
    """Returns the shapes of a hand's stretched fingers.

    The first bending joint stays at its start, which for most models is the straight finger; beyond it, the
    finger is as long as it can be. A spread joint before it thus has no influence, wherever it lies.

    Args:
        hand: the hand.
        start: (n,) joint positions within the limits, rad.
    """
    kinematics, coupling = hand.kinematics().uncoupled()
    middle = 0.5 * (hand.lower + hand.upper)
    fingers = [replace(kinematics, fingers=(chain,)) for chain in kinematics.fingers]
    return [_shape(finger, coupling, start, middle) for finger in fingers]


def _shape(
    kinematics: HandKinematics, coupling: np.ndarray, start: np.ndarray, middle: np.ndarray
) -> FingerShape:
    """Returns the shape of the only finger of `kinematics`."""
    (chain,) = kinematics.fingers
    joints = list(chain.joint_indices)
    lower, upper = kinematics.lower[joints], kinematics.upper[joints]

    def pose(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the joints' axes and origins (N, m, 3) and tips (N, 3) at independent angles q (N, n)."""
        X_BJ = kinematics.joint_poses(q @ coupling.T)[:, joints]
        axes = (X_BJ[..., :3, :3] @ chain.axes[:, :, None])[..., 0]
        return axes, X_BJ[..., :3, 3], X_BJ[:, -1, :3, :3] @ chain.p_tip + X_BJ[:, -1, :3, 3]

    axes = pose(start[None])[0][0]
    bends = np.abs(axes @ axes[-1]) > _PARALLEL
    first = int(np.argmax(bends))
    beyond = [joint for joint, bent in zip(joints[first + 1 :], bends[first + 1 :], strict=True) if bent]
    movers = np.flatnonzero(coupling[beyond].any(axis=0)).tolist() if beyond else []
    q = start.copy()
    for _ in range(2):
        for joint in reversed(movers):
            trials = np.tile(q, (_STRETCH_GRID + 1, 1))
            # The first joints of `uncoupled` are those of q.
            grid = np.linspace(kinematics.lower[joint], kinematics.upper[joint], _STRETCH_GRID)
            trials[:, joint] = [start[joint], *grid]
            _, origins, tips = pose(trials)
            reach = np.linalg.norm(tips - origins[:, first], axis=1)
            longest = int(np.argmax(reach))
            q = trials[longest if reach[longest] > (1 + _STRETCH_GAIN) * reach[0] else 0]
    (axes,), (origins,), (tip,) = pose(q[None])
    angles = (coupling @ q)[joints]
    bend = ((0.5 * (lower + upper) - angles)[:, None] * axes)[bends].sum(axis=0)
    play = float(0.5 * (upper - lower)[bends].sum())
    return FingerShape(origins[0], origins[first], tip, pose(middle[None])[2][0], bend, play)


def unit(v: np.ndarray) -> np.ndarray:
    """Returns v / |v|, or zero for zero."""
    return v / max(float(np.linalg.norm(v)), 1e-12)
