"""Joints without a motor of their own, whose angles follow those of others."""

import dataclasses as dc
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from geort_drake.errors import HandError
from geort_drake.hands.description import CouplingDescription, HandDescription
from geort_drake.hands.mjcf import tendon_couplings


@dc.dataclass(frozen=True)
class JointCouplings:
    """How the K joints that follow depend on the hand's q (n,): ratio · q + offset.

    Attributes:
        names: K joint names.
        leaders: K numbers of the joints of q that they follow.
        ratio: (K, n).
        offset: (K,) rad.
    """

    names: list[str]
    leaders: list[int]
    ratio: np.ndarray
    offset: np.ndarray

    @classmethod
    def of(cls, description: HandDescription) -> "JointCouplings":
        """Those of the joints that follow, directly or not, one that a finger lists."""
        n, joints = len(description.joint_names), description.joint_names
        following = followers(description)
        leaders = [joints.index(leader) for _, leader, _, _ in following]
        rows = [ratio * np.eye(n)[row] for row, (_, _, ratio, _) in zip(leaders, following, strict=True)]
        offset = np.array([offset for *_, offset in following], dtype=float)
        return cls([name for name, *_ in following], leaders, np.array(rows).reshape(-1, n), offset)

    def followed_by(self, q: np.ndarray) -> np.ndarray:
        """(N, n + K) angles of the joints of q (N, n), then of those that follow them, rad."""
        return np.hstack([q, q @ self.ratio.T + self.offset]) if self.names else q


def followers(description: HandDescription) -> list[tuple[str, str, float, float]]:
    """Each joint that follows one that a finger lists: its name, the leader's, ratio and offset in rad."""
    heads = [(c.joint, *root(description.couplings, c)) for c in description.couplings]
    return [head for head in heads if head[1] in description.joint_names]


def root(couplings: list[CouplingDescription], coupling: CouplingDescription) -> tuple[str, float, float]:
    """The joint at the head of a row of followers, and ratio and offset with respect to it."""
    by_name = {other.joint: other for other in couplings}
    leader, ratio, offset = coupling.follows, coupling.ratio, coupling.offset
    while leader in by_name:
        above = by_name[leader]
        offset += ratio * above.offset
        leader, ratio = above.follows, ratio * above.ratio
    return leader, ratio, offset


def leaders_range(ends: np.ndarray, ratio: float, offset: float) -> np.ndarray:
    """(2,) the angles of a leader, rad, at which its follower is within its own limits `ends` (2,)."""
    return np.sort((ends - offset) / ratio)


def read_couplings(path: Path) -> list[CouplingDescription]:
    """The linear couplings of a model file: URDF's and SDF's `mimic`, MJCF's equalities and fixed tendons.

    Drake's parser keeps those of URDF and the SDF element `drake:mimic` to itself and ignores the others.

    Raises:
        HandError: the file is no XML, a number in it is none, or a coupling is not linear.
    """
    tree = model_tree(path)
    try:
        if tree.tag == "mujoco":
            found = [_of_equality(path, joint) for joint in tree.iterfind(".//equality/joint")]
            equal = [coupling for coupling in found if coupling is not None]
            known = {coupling.joint for coupling in equal}
            tendons = [some.coupling for some in tendon_couplings(tree)]
            return equal + [coupling for coupling in tendons if coupling.joint not in known]
        return [
            _of_mimic(mimic, joint.get("name", ""))
            for joint in tree.iter("joint")
            for mimic in joint.iter()
            if re.fullmatch(r"(\{.*\})?mimic", mimic.tag)
        ]
    except ValueError as error:
        raise HandError(f"{path}: a coupling of two joints holds what is no number: {error}") from error


def model_tree(path: Path) -> ET.Element:
    """The XML of a model, with what an MJCF includes; prefixes that nobody declared do no harm."""
    text = path.read_text(encoding="utf-8", errors="replace")
    if "<drake:" in text and "xmlns:drake" not in text:
        text = (
            text.replace("<drake:", "<drake_").replace("</drake:", "</drake_").replace("drake_mimic", "mimic")
        )
    try:
        tree = ET.fromstring(text)
    except ET.ParseError as error:
        raise HandError(f"{path}: not XML: {error}; wanted: a URDF, SDF or MJCF file") from error
    if tree.tag == "mujoco":
        for parent in list(tree.iter()):
            for include in parent.findall("include"):
                file = path.parent / include.get("file", "")
                if file.is_file():
                    parent.remove(include)
                    parent.extend(model_tree(file))
    return tree


def _of_mimic(mimic: ET.Element, joint: str) -> CouplingDescription:
    """URDF: ratio · leader + offset in attributes; SDF: in elements, the leader less a reference."""

    def number(name: str, default: float) -> float:
        return float(mimic.get(name) or mimic.findtext(name) or default)

    ratio = number("multiplier", 1.0)
    offset = number("offset", 0.0) - ratio * number("reference", 0.0)
    return CouplingDescription(joint, mimic.get("joint", ""), ratio, offset)


def _of_equality(path: Path, equality: ET.Element) -> CouplingDescription | None:
    """joint1 = c0 + c1 · joint2 + …; a joint that equals a constant follows none."""
    joint, leader = equality.get("joint1", ""), equality.get("joint2")
    given = [float(value) for value in (equality.get("polycoef") or "0 1 0 0 0").split()]
    offset, ratio, *higher = [*given, 0.0, 0.0][: max(len(given), 2)]
    if leader is None or equality.get("active") == "false":
        return None
    if any(higher):
        raise HandError(
            f"{path}: joint '{joint}' follows '{leader}' by a polynomial, {given}; wanted: two coefficients"
        )
    return CouplingDescription(joint, leader, ratio, offset)
