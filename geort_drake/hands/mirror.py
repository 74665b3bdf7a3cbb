"""Left hands as mirror images: their canonical kinematics and shapes, and the SDF of a left hand.

Human hands are canonical right hands (docs/conventions.md), so left robot hands are trained and evaluated in
the mirror. `models/sdf/allegro_left.sdf` is `left_sdf` of `models/sdf/allegro_right.sdf`.
"""

import re
from typing import TYPE_CHECKING

from geort_drake.errors import HandError
from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.hands.model import HandModel

if TYPE_CHECKING:
    from geort_drake.retargeting.training.collision_geometry import CollisionShapes
    from geort_drake.retargeting.training.kinematics import HandKinematics

# Signs of the numbers in an element under reflection in the xz-plane: x y z roll pitch yaw of a pose, a
# joint's axis, which is an axial vector, and two products of inertia.
_SIGNS = {"pose": (1, -1, 1, -1, 1, -1), "xyz": (-1, 1, -1), "ixy": (-1,), "iyz": (-1,)}
# Shapes without mirror symmetry, and other notations of rotations.
_UNSUPPORTED = ("<mesh", "<polyline", "<heightmap", "degrees=", "rotation_format=")

_HEADER = """<?xml version="1.0"?>
<!--
  The mirror image of {right}.sdf in the xz-plane, made from it by geort_drake/hands/mirror.py; what is
  said there of kinematics, masses, shapes and gains holds here.

  base_link is the hand base B: +x out of the palm, +z along the fingers, +y as on a right hand, so that the
  index finger is on the side of -y. The same joint angles give the mirrored posture, and the limits are the
  same. Units: m, rad, kg.
-->
"""


def canonical_kinematics(hand: HandModel) -> "HandKinematics":
    """The hand's kinematics, of a left hand mirrored in the plane y = 0 of the hand base."""
    return hand.kinematics().mirrored() if hand.description.side == "left" else hand.kinematics()


def canonical_shapes(hand: HandModel) -> "CollisionShapes":
    """The hand's collision shapes, of a left hand mirrored likewise.

    Raises:
        HandError: as for `collision_shapes`.
    """
    shapes = collision_shapes(hand)
    return shapes.mirrored() if hand.description.side == "left" else shapes


def left_sdf(right: str) -> str:
    """The SDF of the left hand that is the mirror image of a right hand.

    Args:
        right: SDF of the right hand, with primitive shapes and a model name that ends in "_right".

    Raises:
        HandError: the SDF holds something that cannot be mirrored, or the model has another name.
    """
    for word in _UNSUPPORTED:
        if word in right:
            raise HandError(f"a model with '{word}' cannot be mirrored; expected primitives and poses in rad")
    name = re.search(r'<model name="(\w+)_right">', right)
    if name is None:
        raise HandError("the model to mirror must have a name that ends in '_right'")
    body = right[right.index("<sdf ") :].replace(f"{name[1]}_right", f"{name[1]}_left")
    for tag, signs in _SIGNS.items():
        element = re.compile(rf"(<{tag}\b[^>]*(?<!/)>)([^<]+)(</{tag}>)")
        pieces = element.split(body)  # text, opening tag, numbers, closing tag, text ...
        pieces[2::4] = [_signed(numbers, signs) for numbers in pieces[2::4]]
        body = "".join(pieces)
    return _HEADER.format(right=f"{name[1]}_right") + body


def _signed(numbers: str, signs: tuple[int, ...]) -> str:
    """The numbers times these signs, with their digits as given."""
    texts = numbers.split()
    if len(texts) != len(signs):
        raise HandError(f"'{numbers}' must be {len(signs)} numbers to be mirrored")
    return " ".join(
        text if sign > 0 or float(text) == 0 else text.removeprefix("-") if text[0] == "-" else f"-{text}"
        for text, sign in zip(texts, signs, strict=True)
    )
