"""Joints without a motor, whose angles follow those of other joints."""

import dataclasses as dc

import numpy as np

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
