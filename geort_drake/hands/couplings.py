"""Joints without a motor, whose angles follow those of other joints."""

import dataclasses as dc

import numpy as np

from geort_drake.hands.description import CouplingDescription, HandDescription


@dc.dataclass(frozen=True)
class JointCouplings:
    """The K followers of a hand: their angles are ratio · q + offset.

    Attributes:
        names: K joint names.
        leaders: K indices of their leaders in q.
        ratio: (K, n).
        offset: (K,) rad.
    """

    names: list[str]
    leaders: list[int]
    ratio: np.ndarray
    offset: np.ndarray

    @classmethod
    def of(cls, description: HandDescription) -> "JointCouplings":
        """The followers, direct or not, of joints that fingers list."""
        n, joints = len(description.joint_names), description.joint_names
        following = followers(description)
        leaders = [joints.index(leader) for _, leader, _, _ in following]
        rows = [ratio * np.eye(n)[row] for row, (_, _, ratio, _) in zip(leaders, following, strict=True)]
        offset = np.array([offset for *_, offset in following], dtype=float)
        return cls([name for name, *_ in following], leaders, np.array(rows).reshape(-1, n), offset)

    def with_followers(self, q: np.ndarray) -> np.ndarray:
        """(N, n + K) angles of the joints of q (N, n) and then of their followers, rad."""
        return np.hstack([q, q @ self.ratio.T + self.offset]) if self.names else q


def followers(description: HandDescription) -> list[tuple[str, str, float, float]]:
    """Each follower of a joint that a finger lists: its name, its leader, ratio and offset in rad."""
    found = [(c.joint, *first_leader(description.couplings, c)) for c in description.couplings]
    return [follower for follower in found if follower[1] in description.joint_names]


def first_leader(
    couplings: list[CouplingDescription], coupling: CouplingDescription
) -> tuple[str, float, float]:
    """The joint at the start of a chain of followers, with ratio and offset relative to it."""
    by_name = {other.joint: other for other in couplings}
    leader, ratio, offset = coupling.follows, coupling.ratio, coupling.offset
    while leader in by_name:
        above = by_name[leader]
        offset += ratio * above.offset
        leader, ratio = above.follows, ratio * above.ratio
    return leader, ratio, offset


def leader_range(limits: np.ndarray, ratio: float, offset: float) -> np.ndarray:
    """(2,) the range of a leader's angle, rad, in which its follower keeps its own limits (2,)."""
    return np.sort((limits - offset) / ratio)
