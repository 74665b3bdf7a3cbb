"""Couplings: joints without a motor, whose angles follow those of other joints."""

import dataclasses as dc

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from geort_drake.errors import HandError
from geort_drake.hands.description import CouplingDescription, HandDescription, resolved_couplings


@dc.dataclass(frozen=True)
class JointCouplings:
    """The K followers of a hand, with angles ratio · q + offset.

    Attributes:
        names: the K joint names.
        ratio: (K, n) factors on q.
        offset: (K,) constant angles, rad.
    """

    names: list[str]
    ratio: np.ndarray
    offset: np.ndarray

    @classmethod
    def of(cls, description: HandDescription) -> "JointCouplings":
        """Collects the direct and indirect followers of the joints that fingers list."""
        couplings, joints = followers(description), description.joint_names
        ratio = np.zeros((len(couplings), len(joints)))
        for row, coupling in zip(ratio, couplings, strict=True):
            row[joints.index(coupling.follows)] = coupling.ratio
        return cls([c.joint for c in couplings], ratio, np.array([c.offset for c in couplings], float))

    def with_followers(self, q: np.ndarray) -> np.ndarray:
        """Returns (N, n + K) angles: q (N, n), then those of the followers, rad."""
        return np.hstack([q, q @ self.ratio.T + self.offset]) if self.names else q


def followers(description: HandDescription) -> list[CouplingDescription]:
    """Returns the direct and indirect couplings to joints that fingers list, resolved to these joints."""
    return [c for c in resolved_couplings(description.couplings) if c.follows in description.joint_names]


def position_limits(
    plant: MultibodyPlant, description: HandDescription, hand: ModelInstanceIndex, source: str
) -> tuple[np.ndarray, np.ndarray]:
    """Returns lower and upper limits (n,) of q, rad, within which followers keep their own limits.

    Args:
        plant: plant with the hand.
        description: the hand.
        hand: model instance of the hand, from `add_hand_model`.
        source: beginning of error messages.

    Raises:
        HandError: a follower would exceed its limits at every angle of its leader.
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
                f"{source}: joint '{c.joint}', which follows '{c.follows}', would exceed its limits "
                f"[{ends[0]:g}, {ends[1]:g}] rad at every angle of that joint; correct its coupling or its "
                "limits"
            )
    return lower, upper
