"""Values of a model that Drake replaces by its own, with a warning at most: masses, sizes, vertices."""

import itertools
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from pathlib import Path

from geort_drake.errors import HandError
from geort_drake.hands.couplings import model_tree
from geort_drake.hands.mjcf import hand_down_defaults

_MOMENTS, _PRODUCTS = ("ixx", "iyy", "izz"), ("ixy", "ixz", "iyz")
_MODELS = (".sdf", ".urdf", ".xml", ".mjcf")
_SHAPES = ("box", "sphere", "cylinder", "capsule", "ellipsoid", "cone")
_SIZES = ("size", "radius", "length", "radii")
# A line of a vertex that does not begin with three finite numbers.
_NUMBER = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE](?:-\d+|\+?0*\d{1,2}))?"
_NO_VERTEX = re.compile(rb"^[ \t]*v[ \t](?![ \t]*" + rb"[ \t]+".join([_NUMBER] * 3) + rb"(?:\s|#|$)).*", re.M)


def check_model_values(files: Iterable[Path], source: str) -> None:
    """Looks at the values of a hand's model files and collision meshes, where they are text.

    Args:
        files: what `model_files` returns; others than URDF, SDF, MJCF and OBJ pass.
        source: of the hand, for the message.

    Raises:
        HandError: a mass, a moment of inertia or a size is negative or not finite, or a vertex or a product
            of inertia is not finite, or defaults of MJCF do not reach what takes them.
    """
    for file in files:
        if file.suffix.lower() in _MODELS:
            tree = model_tree(file)
            for name, wanted, given in _wrong_values(tree):
                raise HandError(f"{source}: {name} in {file.name} must be {wanted}; given: {given[:60]}")
            if tree.tag == "mujoco" and (classes := hand_down_defaults(tree)):
                raise HandError(
                    f"{source}: in {file.name} the classes {', '.join(classes)} take defaults that Drake "
                    "ignores; use the copy that geort-drake add-hand writes"
                )
        elif file.suffix.lower() == ".obj" and (found := _NO_VERTEX.search(file.read_bytes())):
            line = found[0].decode(errors="replace").strip()
            raise HandError(
                f"{source}: {file}: every vertex must be three finite numbers; given: {line[:60]}"
            )


def _wrong_values(tree: ET.Element) -> Iterator[tuple[str, str, str]]:
    """What must be something else: its name, what it must be, and what it is."""
    for owner in itertools.chain(tree.iter("link"), tree.iter("body")):
        where = f"of link '{owner.get('name', '')}'"
        for inertial in owner.findall("inertial"):
            for mass in [*inertial.findall("mass"), inertial]:
                yield from _refused(
                    f"the mass {where}", mass.get("value") or mass.get("mass") or mass.text, 0.0
                )
            for inertia in inertial.findall("inertia"):
                for name in (*_MOMENTS, *_PRODUCTS):
                    lowest = 0.0 if name in _MOMENTS else -math.inf
                    text = inertia.get(name) or inertia.findtext(name)
                    yield from _refused(f"{name} {where}", text, lowest)
        for shape in owner.iterfind("collision/geometry/*"):
            for name in _SIZES if shape.tag in _SHAPES else ():
                yield from _refused(
                    f"the {shape.tag}'s {name} {where}", shape.get(name) or shape.findtext(name), 0.0
                )
    for geom in tree.iter("geom"):
        for name in ("mass", "density"):
            yield from _refused(f"{name} of geom '{geom.get('name', '')}'", geom.get(name), 0.0)


def _refused(name: str, text: str | None, lowest: float) -> Iterator[tuple[str, str, str]]:
    """Yields what `_wrong_values` does where one of the numbers in a text is wrong; no text is no number."""
    wanted = "finite" if lowest < 0.0 else "finite and not negative"
    for part in (text or "").split():
        try:
            value = float(part)
        except ValueError:
            value = math.nan
        if not lowest <= value < math.inf or value == -math.inf:
            yield name, wanted, part
