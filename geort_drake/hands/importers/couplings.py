"""Reads couplings of joints from URDF, SDF and MJCF files, including fixed tendons of MJCF."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from geort_drake.errors import HandError, listed
from geort_drake.hands.description import CouplingDescription
from geort_drake.hands.model_files import read_model

# A tendon couples its joints if its range leaves them at most this much play to either side, rad.
_MAX_PLAY = 0.2


def read_couplings(path: Path) -> list[CouplingDescription]:
    """Reads a model's linear couplings: `mimic` in URDF and SDF, equalities and fixed tendons in MJCF.

    Drake applies URDF's `mimic` and SDF's `drake:mimic` without giving access to them, and ignores the rest.

    Raises:
        HandError: the file is not XML, a number is malformed, or a coupling is not linear.
    """
    tree = read_model(path)
    try:
        if tree.tag == "mujoco":
            found = [_equality_coupling(path, joint) for joint in tree.iterfind(".//equality/joint")]
            couplings = [coupling for coupling in found if coupling is not None]
            known = {coupling.joint for coupling in couplings}
            tendons = [tendon.coupling for tendon in tendon_couplings(tree)]
            return couplings + [coupling for coupling in tendons if coupling.joint not in known]
        return [
            _mimic_coupling(mimic, joint.get("name", ""))
            for joint in tree.iter("joint")
            for mimic in joint.iter()
            if re.fullmatch(r"(\{.*\})?mimic", mimic.tag)
        ]
    except ValueError as error:
        raise HandError(f"{path}: a coupling of two joints contains a malformed number: {error}") from error


def _mimic_coupling(mimic: ET.Element, joint: str) -> CouplingDescription:
    """Reads ratio and offset from attributes (URDF) or elements (SDF, which may also have a reference)."""

    def number(name: str, default: float) -> float:
        return float(mimic.get(name) or mimic.findtext(name) or default)

    ratio = number("multiplier", 1.0)
    offset = number("offset", 0.0) - ratio * number("reference", 0.0)
    return CouplingDescription(joint, mimic.get("joint", ""), ratio, offset)


def _equality_coupling(path: Path, equality: ET.Element) -> CouplingDescription | None:
    """Reads joint1 = c0 + c1 · joint2 + …; returns None if it is inactive or has no second joint."""
    joint, leader = equality.get("joint1", ""), equality.get("joint2")
    given = [float(value) for value in (equality.get("polycoef") or "0 1 0 0 0").split()]
    offset, ratio, *higher = [*given, 0.0, 0.0][: max(len(given), 2)]
    if leader is None or equality.get("active") == "false":
        return None
    if any(higher):
        raise HandError(
            f"{path}: joint '{joint}' follows '{leader}' by a polynomial; expected two coefficients, "
            f"given: {given}"
        )
    return CouplingDescription(joint, leader, ratio, offset)


@dataclass(frozen=True)
class TendonCoupling:
    """A coupling of two joints by a tendon; `assumed` if the tendon pulls but does not constrain them."""

    tendon: str
    coupling: CouplingDescription
    assumed: bool


def tendon_couplings(tree: ET.Element) -> list[TendonCoupling]:
    """Reads the couplings by fixed tendons of two joints, whose length is c1 · q1 + c2 · q2.

    A tendon couples its joints if an equality fixes its length, if its range leaves little play, or if a
    motor pulls it and none moves either joint. In the last case both joints are assumed to be equally stiff,
    so they turn in proportion to their coefficients. The joint without a motor follows, else the outer one.
    Joints that an equality couples are left out.

    Raises:
        ValueError: a number is malformed.
    """
    driven = {motor.get("joint") for motor in _motors(tree)}
    pulled = {motor.get("tendon") for motor in _motors(tree)}
    fixed_lengths = {
        equality.get("tendon1"): float((equality.get("polycoef") or "0").split()[0])
        for equality in tree.iterfind(".//equality/tendon")
        if equality.get("tendon2") is None and equality.get("active") != "false"
    }
    equal = _equal_joints(tree)
    order = [joint.get("name", "") for body in tree.iter("worldbody") for joint in body.iter("joint")]
    found: dict[str, TendonCoupling] = {}
    for tendon in tree.iterfind(".//tendon/fixed"):
        parts = {part.get("joint", ""): float(part.get("coef", 1.0)) for part in tendon.findall("joint")}
        parts = {joint: c for joint, c in parts.items() if joint in order and c != 0.0}
        if len(parts) != 2 or len(tendon) != 2 or {*parts} in equal:
            continue
        leader, joint = sorted(parts, key=order.index)
        if leader not in driven and joint in driven:
            leader, joint = joint, leader
        name, own, other = tendon.get("name", ""), parts[joint], parts[leader]
        length = fixed_lengths.get(name, _narrow_length(tree, tendon, min(map(abs, parts.values()))))
        if length is not None:
            coupling = CouplingDescription(joint, leader, -other / own, length / own)
        elif name in pulled and not {joint, leader} & driven:
            coupling = CouplingDescription(joint, leader, own / other, 0.0)
        else:
            continue
        found.setdefault(joint, TendonCoupling(name, coupling, length is None))
    return list(found.values())


def coupling_notes(tree: ET.Element) -> list[str]:
    """Returns notes for the user on assumed couplings, and on ignored tendons and closed loops."""
    known, equal = tendon_couplings(tree), _equal_joints(tree)
    notes = [
        f"one motor pulls '{c.follows}' and '{c.joint}'; assuming equal stiffness, '{c.joint}' follows by "
        f"{c.ratio:g}"
        for c in (tendon.coupling for tendon in known if tendon.assumed)
    ]
    pulled = dict.fromkeys(motor.get("tendon", "") for motor in _motors(tree) if motor.get("tendon"))
    coupling = {tendon.tendon for tendon in known}
    for tendon in tree.iterfind(".//tendon/fixed"):
        if {joint.get("joint") for joint in tendon} in equal:
            coupling.add(tendon.get("name", ""))
    if ignored := [f"'{name}'" for name in pulled if name not in coupling]:
        notes.append(
            f"tendons that motors pull are ignored, their joints move independently: {listed(ignored)}"
        )
    for equality in (*tree.iterfind(".//equality/connect"), *tree.iterfind(".//equality/weld")):
        ends = [equality.get(f"body{n}") or equality.get(f"site{n}") for n in (1, 2)]
        if all(ends):
            notes.append(f"the closed loop at '{ends[0]}' and '{ends[1]}' is ignored: a hand must be a tree")
    return notes


def _equal_joints(tree: ET.Element) -> list[set[str | None]]:
    """Returns the pairs of joints that an active equality couples."""
    equalities = [joint for joint in tree.iterfind(".//equality/joint") if joint.get("active") != "false"]
    return [{joint.get("joint1"), joint.get("joint2")} for joint in equalities]


def _motors(tree: ET.Element) -> Iterator[ET.Element]:
    return (motor for actuator in tree.iter("actuator") for motor in actuator)


def _narrow_length(tree: ET.Element, tendon: ET.Element, coefficient: float) -> float | None:
    """Returns the middle of a tendon's range if the range leaves its joints little play, else None."""
    defaults = [d for d in tree.iter("default") if d.get("class", "main") == tendon.get("class", "main")]
    settings: dict[str, str] = {}
    for element in (*(node for default in defaults for node in default.findall("tendon")), tendon):
        settings |= element.attrib
    compilers = [compiler.get("autolimits", "true") for compiler in tree.iter("compiler")]
    limited = settings.get("limited", "auto")
    if "range" not in settings or limited == "false" or (limited == "auto" and "false" in compilers):
        return None
    low, high = (float(value) for value in settings["range"].split())
    return 0.5 * (low + high) if 0.5 * (high - low) / coefficient <= _MAX_PLAY else None
