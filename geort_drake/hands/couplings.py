"""Joints without a motor, whose angles follow those of other joints."""

import dataclasses as dc

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from geort_drake.errors import HandError
from geort_drake.hands.description import CouplingDescription, HandDescription, resolved_couplings


@dc.dataclass(frozen=True)
class JointCouplings:
    """The K followers of a hand: their angles are ratio · q + offset.

    Attributes:
        names: K joint names.
        ratio: (K, n).
        offset: (K,) rad.
    """

    names: list[str]
    ratio: np.ndarray
    offset: np.ndarray

    @classmethod
    def of(cls, description: HandDescription) -> "JointCouplings":
        """The followers, direct or not, of joints that fingers list."""
        couplings, joints = followers(description), description.joint_names
        ratio = np.zeros((len(couplings), len(joints)))
        for row, coupling in zip(ratio, couplings, strict=True):
            row[joints.index(coupling.follows)] = coupling.ratio
        return cls([c.joint for c in couplings], ratio, np.array([c.offset for c in couplings], float))

    def with_followers(self, q: np.ndarray) -> np.ndarray:
        """(N, n + K) angles of the joints of q (N, n) and then of their followers, rad."""
        return np.hstack([q, q @ self.ratio.T + self.offset]) if self.names else q


def followers(description: HandDescription) -> list[CouplingDescription]:
    """The couplings, direct or not, to joints that fingers list."""
    return [c for c in resolved_couplings(description.couplings) if c.follows in description.joint_names]


def position_limits(
    plant: MultibodyPlant, description: HandDescription, hand: ModelInstanceIndex, source: str
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) lower and upper limits of q, rad, within which followers keep their own limits.

    Args:
        plant: with the hand.
        description: of the hand.
        hand: its model instance, from `add_hand_model`.
        source: how errors begin.

    Raises:
        HandError: a follower would leave its limits at every angle of its leader.
    """
    joints = [plant.GetJointByName(name, hand) for name in description.joint_names]
    lower = np.array([joint.position_lower_limits()[0] for joint in joints])
    upper = np.array([joint.position_upper_limits()[0] for joint in joints])
    for c in followers(description):
        leader, follower = description.joint_names.index(c.follows), plant.GetJointByName(c.joint, hand)
        ends = np.array([follower.position_lower_limits()[0], follower.position_upper_limits()[0]])
        low, high = np.sort((ends - c.offset) / c.ratio)
        lower[leader], upper[leader] = max(lower[leader], low), min(upper[leader], high)
        if not lower[leader] < upper[leader]:
            raise HandError(
                f"{source}: joint '{c.joint}', which follows '{c.follows}', would leave its limits "
                f"[{ends[0]:g}, {ends[1]:g}] rad at every angle of that joint; correct its couplings or its "
                "limits"
            )
    return lower, upper
