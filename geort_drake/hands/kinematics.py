"""A hand's fingers as serial chains, and its collision shapes, as plain arrays."""

from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np


@dataclass(frozen=True)
class FingerChain:
    """One finger: a serial chain of revolute joints from the hand base B to the fingertip point.

    Attributes:
        name: name of the finger.
        joint_names: names of the k independent joints, base to tip.
        joint_indices: indices of these k joints in the hand's q.
        X_PJ: (m, 4, 4) pose, m, of each of the m ≥ k joint frames J in its parent's joint frame P (B for the
            first), at zero angle of the joint, or of the one that it follows.
        axes: (m, 3) unit rotation axes in J.
        p_tip: (3,) fingertip point in the last joint's moving frame, m.
        all_joint_names: names of all m joints, base to tip.
        coupling: (m, k) rotation of each joint per rotation of the k joints.
    """

    name: str
    joint_names: tuple[str, ...]
    joint_indices: tuple[int, ...]
    X_PJ: np.ndarray
    axes: np.ndarray
    p_tip: np.ndarray
    all_joint_names: tuple[str, ...]
    coupling: np.ndarray


@dataclass(frozen=True)
class HandKinematics:
    """The fingers of a hand, with q in the order of `joint_names`.

    Attributes:
        fingers: the F chains.
        joint_names: names of the n joints in the order of q.
        lower, upper: (n,) joint limits, rad.
        tip_radius: radius of the fingertip spheres, m.
        p_BW: (3,) the hand's wrist in its base, m.
    """

    fingers: tuple[FingerChain, ...]
    joint_names: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    tip_radius: float
    p_BW: np.ndarray
    # What a forward pass has computed from the constants, by its data type and device.
    constants: dict = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def finger_names(self) -> tuple[str, ...]:
        return tuple(finger.name for finger in self.fingers)

    def mirrored(self) -> "HandKinematics":
        """Returns the mirror image in the xz-plane, whose fingertips are at (x, −y, z) for the same q.

        A left robot hand is mirrored to compare it with human hands, which are always stored as right hands.
        """
        M = np.diag([1.0, -1.0, 1.0, 1.0])
        fingers = [
            # A rotation axis is an axial vector, so its reflection changes sign.
            replace(f, X_PJ=M @ f.X_PJ @ M, axes=-f.axes @ M[:3, :3], p_tip=M[:3, :3] @ f.p_tip)
            for f in self.fingers
        ]
        return replace(self, fingers=tuple(fingers), p_BW=M[:3, :3] @ self.p_BW)

    def to_last_joints(self) -> "HandKinematics":
        """Returns the hand whose fingertip points are the origins of the fingers' last joints."""
        fingers = tuple(replace(finger, p_tip=np.zeros(3)) for finger in self.fingers)
        return replace(self, fingers=fingers)

    def uncoupled(self) -> tuple["HandKinematics", np.ndarray]:
        """Returns the hand with independent joints in place of coupled ones.

        Returns:
            A hand with the n joints of this one, then the followers, N in total; and the matrix (N, n) from
            this hand's joint angles to those of that hand.
        """
        names = list(self.joint_names)
        rows = [*np.eye(len(names))]
        for finger in self.fingers:
            for name, row in zip(finger.all_joint_names, finger.coupling, strict=True):
                if name not in names:
                    names.append(name)
                    rows.append(np.zeros(len(self.joint_names)))
                    rows[-1][list(finger.joint_indices)] = row
        fingers = [
            replace(
                finger,
                joint_names=finger.all_joint_names,
                joint_indices=tuple(names.index(name) for name in finger.all_joint_names),
                coupling=np.eye(len(finger.all_joint_names)),
            )
            for finger in self.fingers
        ]
        matrix = np.array(rows)
        ends = matrix * self.lower, matrix * self.upper
        lower, upper = np.minimum(*ends).sum(1), np.maximum(*ends).sum(1)
        hand = replace(self, fingers=tuple(fingers), joint_names=tuple(names), lower=lower, upper=upper)
        return hand, matrix


@dataclass(frozen=True)
class CollisionShapes:
    """The S collision shapes of a hand as plain arrays: convex hulls, of points or of equal spheres.

    Attributes:
        joint: (S,) number of the joint that moves the shape, among those of `HandKinematics.uncoupled()`;
            −1 where it is fixed to the base B.
        X_JS: (S, 4, 4) pose of the shape S in its joint's moving frame J, or in B, m.
        vertices: (S, V, 3) points in S, m, some of them repeated; the shape contains them.
        radius: (S,) distance of the shape's surface from the convex hull of the vertices, m.
        pairs: (P, 2) numbers of shapes that must not touch.
    """

    joint: np.ndarray
    X_JS: np.ndarray
    vertices: np.ndarray
    radius: np.ndarray
    pairs: np.ndarray


def lattice_directions() -> np.ndarray:
    """Returns the 98 unit vectors (98, 3) through the points of a 5 × 5 grid on the faces of a cube.

    Each direction is at most 15° from the nearest one.
    """
    points = np.array(list(product(range(-2, 3), repeat=3)), dtype=float)
    points = points[np.abs(points).max(axis=1) == 2]
    return points / np.linalg.norm(points, axis=1, keepdims=True)
