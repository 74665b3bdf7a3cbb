"""Default classes of MJCF. Drake loses some of their settings."""

import copy
import xml.etree.ElementTree as ET
from collections.abc import Iterator

# The elements for which Drake reads defaults.
_TAGS_WITH_DEFAULTS = ("joint", "geom", "mesh", "position", "motor", "general")


def inherit_defaults(tree: ET.Element) -> list[str]:
    """Writes into every default class the settings that it inherits from the classes around it.

    Drake 1.51 inherits an element's settings only if the inner class has such an element itself. Through a
    class without one, joints, geoms and actuators lose axes, limits, sizes and gains.

    Returns:
        The classes for which Drake loses settings that an element of the model uses.
    """
    losing: dict[str, set[str]] = {}  # tag → classes for which Drake loses some settings

    def visit(default: ET.Element, inherited: dict[str, ET.Element], lost: frozenset[str]) -> None:
        for tag, outer in inherited.items():
            own = default.find(tag)
            if own is None:
                default.append(copy.deepcopy(outer))
                lost |= {tag}
            else:
                for key, value in outer.attrib.items():
                    own.attrib.setdefault(key, value)
        for tag in lost:
            losing.setdefault(tag, set()).add(default.get("class", "main"))
        here = {own.tag: own for own in default if own.tag != "default"}
        for child in default.findall("default"):
            visit(child, here, lost)

    for outermost in tree.findall("default"):
        visit(outermost, {}, frozenset())
    return sorted({name for tag, name in _used_classes(tree) if name in losing.get(tag, ())})


def _used_classes(tree: ET.Element) -> Iterator[tuple[str, str]]:
    """Tag and default class of every element outside the defaults."""

    def visit(element: ET.Element, childclass: str) -> Iterator[tuple[str, str]]:
        if element.tag in _TAGS_WITH_DEFAULTS:
            yield element.tag, element.get("class", childclass)
        inside = element.get("childclass", childclass)
        for child in element:
            yield from visit(child, inside)

    for section in tree:
        if section.tag != "default":
            yield from visit(section, "main")
