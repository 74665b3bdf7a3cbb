"""What MuJoCo reads in an MJCF file and Drake does not: defaults handed down, tendons, closed loops.

MuJoCo's XML reference, elements `default`, `tendon/fixed` and `equality`.
"""

import copy
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass

from geort_drake.hands.description import CouplingDescription

# What Drake takes defaults for.
_WITH_DEFAULTS = ("joint", "geom", "mesh", "position", "motor", "general")
# A tendon that leaves a joint this much play to either side holds it to the other one, rad.
_PLAY = 0.2
_NAMED = 3  # things that a sentence names


def hand_down_defaults(tree: ET.Element) -> list[str]:
    """Writes into every class of defaults the elements that it has only from the classes around it.

    Drake 1.51 hands the settings of an element down to the next class only where that has such an element
    itself, so a class in between that has none leaves those within it without axes, limits, sizes and gains.

    Returns:
        The names of those classes that lacked something which an element of the model takes from them.
    """
    lacking: dict[str, set[str]] = {}  # tag → classes for which Drake loses some of it

    def visit(default: ET.Element, inherited: dict[str, ET.Element], lost: frozenset[str]) -> None:
        for tag, above in inherited.items():
            own = default.find(tag)
            if own is None:
                default.append(copy.deepcopy(above))
                lost |= {tag}
            else:
                for key, value in above.attrib.items():
                    own.attrib.setdefault(key, value)
        for tag in lost:
            lacking.setdefault(tag, set()).add(default.get("class", "main"))
        here = {own.tag: own for own in default if own.tag != "default"}
        for child in default.findall("default"):
            visit(child, here, lost)

    for outermost in tree.findall("default"):
        visit(outermost, {}, frozenset())
    return sorted({name for tag, name in _taken(tree) if name in lacking.get(tag, ())})


def _taken(tree: ET.Element) -> Iterator[tuple[str, str]]:
    """The tag of every element that takes defaults, and of which class it takes them."""

    def visit(element: ET.Element, childclass: str) -> Iterator[tuple[str, str]]:
        if element.tag in _WITH_DEFAULTS:
            yield element.tag, element.get("class", childclass)
        inside = element.get("childclass", childclass)
        for child in element:
            yield from visit(child, inside)

    for section in tree:
        if section.tag != "default":
            yield from visit(section, "main")


@dataclass(frozen=True)
class _Tendon:
    """A fixed tendon of two joints: its length is c1 · q1 + c2 · q2; the second joint is farther out."""

    name: str
    joints: tuple[str, str]
    coefficients: tuple[float, float]
    element: ET.Element


@dataclass(frozen=True)
class TendonCoupling:
    """What a tendon makes of two joints; `assumed` where it pulls both and holds neither."""

    tendon: str
    coupling: CouplingDescription
    assumed: bool


def tendon_couplings(tree: ET.Element) -> list[TendonCoupling]:
    """The couplings that fixed tendons of two joints make.

    A tendon couples its joints where an equality holds its length, where its range leaves next to no play, or
    where one motor pulls it and none moves either joint: then the pull turns both, as far as they are equally
    stiff, in proportion to their coefficients. The joint without a motor follows, else the outer one.

    Raises:
        ValueError: a number is none.
    """
    tree = copy.deepcopy(tree)
    hand_down_defaults(tree)
    driven = {motor.get("joint") for motor in _motors(tree)}
    pulled = {motor.get("tendon") for motor in _motors(tree)}
    held = {
        equality.get("tendon1"): float((equality.get("polycoef") or "0").split()[0])
        for equality in tree.iterfind(".//equality/tendon")
        if equality.get("tendon2") is None and equality.get("active") != "false"
    }
    found: dict[str, TendonCoupling] = {}
    for tendon in _tendons(tree):
        length = held.get(tendon.name, _narrow_length(tree, tendon))
        follower = 0 if tendon.joints[0] not in driven and tendon.joints[1] in driven else 1
        joint, leader = tendon.joints[follower], tendon.joints[1 - follower]
        own, other = tendon.coefficients[follower], tendon.coefficients[1 - follower]
        if length is not None:
            coupling = CouplingDescription(joint, leader, -other / own, length / own)
        elif tendon.name in pulled and not {joint, leader} & driven:
            coupling = CouplingDescription(joint, leader, own / other, 0.0)
        else:
            continue
        found.setdefault(joint, TendonCoupling(tendon.name, coupling, length is None))
    return list(found.values())


def remarks(tree: ET.Element) -> list[str]:
    """Sentences on what ties links or joints together and is read by an assumption, or not at all."""
    said = []
    known = tendon_couplings(tree)
    if assumed := [some.coupling for some in known if some.assumed]:
        rows = [f"'{c.joint}' follows '{c.follows}' by {c.ratio:g}" for c in assumed]
        said.append(f"one motor pulls two joints; as if both were equally stiff, {some_of(rows)}")
    coupling = {some.tendon for some in known}
    pulled = dict.fromkeys(motor.get("tendon", "") for motor in _motors(tree) if motor.get("tendon"))
    if others := [f"'{name}'" for name in pulled if name not in coupling]:
        said.append(
            f"tendons that motors pull are not read: {some_of(others)}; their joints move each by itself, "
            "unless couplings tie them"
        )
    loops = [
        f"'{first}' and '{second}'"
        for tag in ("connect", "weld")
        for equality in tree.iterfind(f".//equality/{tag}")
        if (first := equality.get("body1") or equality.get("site1"))
        and (second := equality.get("body2") or equality.get("site2"))
    ]
    if loops:
        said.append(
            f"links that close a loop are not read, so that their joints move freely: {some_of(loops)}; a "
            "hand of chains is wanted"
        )
    return said


def some_of(rows: list[str]) -> str:
    """The first few of a list, and how many more there are."""
    return ", ".join(rows[:_NAMED]) + (f" and {len(rows) - _NAMED} more" if len(rows) > _NAMED else "")


def _motors(tree: ET.Element) -> list[ET.Element]:
    return [motor for actuator in tree.iter("actuator") for motor in actuator]


def _tendons(tree: ET.Element) -> Iterator[_Tendon]:
    order = [joint.get("name", "") for body in tree.iter("worldbody") for joint in body.iter("joint")]
    for fixed in tree.iterfind(".//tendon/fixed"):
        parts = {part.get("joint", ""): float(part.get("coef", 1.0)) for part in fixed.findall("joint")}
        parts = {joint: c for joint, c in parts.items() if joint in order and c != 0.0}
        if len(parts) == 2 and len(fixed) == 2:
            inner, outer = sorted(parts, key=order.index)
            yield _Tendon(fixed.get("name", ""), (inner, outer), (parts[inner], parts[outer]), fixed)


def _narrow_length(tree: ET.Element, tendon: _Tendon) -> float | None:
    """The middle of the tendon's range where that leaves its joints next to no play; else None."""
    limits = _setting(tree, tendon.element, "range")
    limited = _setting(tree, tendon.element, "limited") or "auto"
    compiler = [node.get("autolimits", "true") for node in tree.iter("compiler")]
    if limits is None or limited == "false" or (limited == "auto" and "false" in compiler):
        return None
    low, high = (float(value) for value in limits.split())
    play = 0.5 * (high - low) / min(map(abs, tendon.coefficients))
    return 0.5 * (low + high) if play <= _PLAY else None


def _setting(tree: ET.Element, tendon: ET.Element, name: str) -> str | None:
    """A tendon's own value, else that of its class, in a tree whose defaults are handed down."""
    wanted = tendon.get("class", "main")
    defaults = (default for default in tree.iter("default") if default.get("class", "main") == wanted)
    nodes = [tendon, *(node for default in defaults for node in default.findall("tendon"))]
    return next((value for node in nodes if (value := node.get(name)) is not None), None)
