"""The SDF of a left hand, made from that of the right one.

`models/sdf/allegro_left.sdf` is `left_sdf` of the text of `models/sdf/allegro_right.sdf`.
"""

import re

from geort_drake.errors import HandError

# The signs that a reflection in the xz-plane gives to what stands in an element: to x y z roll pitch yaw of
# a pose, to a joint's axis, which is an axial vector, and to two products of inertia.
_SIGNS = {"pose": (1, -1, 1, -1, 1, -1), "xyz": (-1, 1, -1), "ixy": (-1,), "iyz": (-1,)}
# Shapes that are not their own mirror images, and other ways of writing a rotation.
_UNKNOWN = ("<mesh", "<polyline", "<heightmap", "degrees=", "rotation_format=")

_HEADER = """<?xml version="1.0"?>
<!--
  The mirror image of {right}.sdf in the xz-plane, made from it by geort_drake/hands/mirror.py; what is
  said there of kinematics, masses, shapes and gains holds here.

  base_link is the hand base B: +x out of the palm, +z along the fingers, +y as on a right hand, so that the
  index finger is on the side of -y. The same joint angles give the mirrored posture, and the limits are the
  same. Units: m, rad, kg.
-->
"""


def left_sdf(right: str) -> str:
    """The SDF text of the left hand whose every frame, mass and shape is the right hand's mirror image.

    Args:
        right: SDF text of the right hand, with primitives for shapes and its model's name on "_right".

    Raises:
        HandError: the text holds what cannot be mirrored, or its model is not called a right hand.
    """
    for word in _UNKNOWN:
        if word in right:
            raise HandError(f"a model with '{word}' cannot be mirrored; wanted: primitives, poses in rad")
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
    """The numbers with these signs put before them, digit by digit as they were."""
    texts = numbers.split()
    if len(texts) != len(signs):
        raise HandError(f"'{numbers}' must be {len(signs)} numbers to be mirrored")
    return " ".join(
        text if sign > 0 or float(text) == 0 else text.removeprefix("-") if text[0] == "-" else f"-{text}"
        for text, sign in zip(texts, signs, strict=True)
    )
