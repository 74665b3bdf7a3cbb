"""Places the contacts of a grip on an object, from its shape alone."""

import dataclasses as dc
import math

import numpy as np
import yaml
from pydrake.geometry import Box, Ellipsoid, Shape, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.errors import UnknownNameError
from geort_drake.resources import models_dir
from geort_drake.simulation.object_shape import ObjectShape, half_extents

# Distances of adjacent fingers from the middle of a flat side, m. Thick fingers need more: if no grasp is
# found with one distance, the next is tried.
_OFFSETS = (0.014, 0.017, 0.02)
# Largest vertical distance between the contacts of adjacent fingers in a power grasp, m.
_MAX_STEP = 0.04
# Least distance of a contact from the edges of its surface, m.
_EDGE = 0.003
# At an object whose sides end below the usual height of the fingertips, these come nearer to its support by
# one of these lengths, m, and touch its upper edge; their centres may be `_ABOVE_EDGE`, m, above it. With
# the tolerance of inverse kinematics, 1 mm, a tip of 12 mm touches the edge at up to 12° from the horizontal
# squeeze; the smallest friction between tip and object, of μ = 0.45, allows 24°.
_LOWER = (0.0015, 0.001)
_ABOVE_EDGE = 0.0015


# Ways to hold an upright object: grip → touching finger → its angle about the vertical from the grip's axis,
# rad, and its level above the grip's height, in fingers. The axis runs from the thumb to the fingers. Angles
# are for a right hand; a left hand's are negated. Names follow the taxonomy of grasps (Cutkosky 1989; Feix et
# al. 2016): pinch and tripod are precision grasps between fingertips; a power grasp presses the object into
# the palm.
GRIPS = {
    "pinch": {"thumb": (math.pi, 0), "index": (0.0, 0)},
    "tripod": {"thumb": (math.pi, 0), "index": (math.radians(28), 0), "middle": (math.radians(-28), 0)},
    # The fingers reach around the far side, so that they and the thumb press towards the palm.
    "power": {
        "thumb": (math.radians(150), 0),
        "index": (math.radians(45), 1),
        "middle": (math.radians(45), 0),
        "ring": (math.radians(45), -1),
    },
}
PALM_GRIP = "power"  # with the object in the palm, whose normal is at 90° from the grip's axis


def grip_of(name: str) -> str:
    """Returns the name of an object's grip, one of `GRIPS`, from models/objects.yaml.

    Raises:
        UnknownNameError: the object is not listed there, or its grip does not exist.
    """
    path = models_dir() / "objects.yaml"
    grips = yaml.safe_load(path.read_text(encoding="utf-8"))
    if name not in grips:
        raise UnknownNameError(f"object in {path}", name, grips)
    if grips[name] not in GRIPS:
        raise UnknownNameError(f"grip of object '{name}' in {path}", str(grips[name]), GRIPS)
    return grips[name]


@dc.dataclass(frozen=True)
class Contact:
    """A contact of a finger or the palm: a surface point, m, and the inward unit normal, both in O."""

    part: str
    p_OC: np.ndarray
    n_O: np.ndarray


def grip_contacts(
    shape: ObjectShape,
    yaw: float,
    height: float = 0.5,
    grip: str = "tripod",
    side: str = "right",
    offset: float = _OFFSETS[0],
    spacing: float = math.inf,
) -> list[Contact]:
    """Returns the contacts of a grip on the object's main part; that of the palm is the last one.

    Args:
        yaw: direction of the grip's axis from the thumb to the fingers, rad.
        height: height of the grip as a fraction of the object's height.
        grip: one of `GRIPS`.
        side: "left" or "right", of the hand.
        offset: one of `finger_offsets`, m.
        spacing: distance between contacts of adjacent fingers, m, for fingers that cannot spread as far as
            the grip defines.
    """
    bottom, top = vertical_extent(shape)
    z = bottom + height * (top - bottom)
    step, widest = min(spacing, _MAX_STEP), math.pi / 2
    if math.isfinite(spacing) and grip != PALM_GRIP:
        offset = spacing / 2
        widest = math.asin(min(offset / half_extents(shape.main[0])[0], 1.0))
    sign = -1.0 if side == "left" else 1.0
    contacts = []
    for finger, (angle, level) in GRIPS[grip].items():
        is_thumb = abs(angle) > math.pi / 2
        turn = angle if is_thumb else float(np.clip(angle, -widest, widest))
        contacts.append(_contact(shape, finger, yaw, sign * turn, z + level * step, offset))
    if grip == PALM_GRIP:
        contacts.append(_contact(shape, "palm", yaw - sign * math.pi / 2, 0.0, z, offset=0.0))
    return contacts


def _contact(shape: ObjectShape, part: str, yaw: float, angle: float, z: float, offset: float) -> Contact:
    main, X_OG = shape.main
    direction = np.array([math.cos(yaw + angle), math.sin(yaw + angle), 0.0])
    if isinstance(main, Box):
        p, outward = _on_box(main.size() / 2, X_OG, direction, yaw, offset)
    else:
        p, outward = direction * _radius_at(main, direction, z - X_OG.translation()[2]), direction
        p = p + X_OG.translation() * [1, 1, 0]
    return Contact(part, np.array([p[0], p[1], z]), -outward)


def vertical_extent(shape: ObjectShape) -> tuple[float, float]:
    """Returns the lowest and the highest z of the upright object in O, m."""
    upside_down = RigidTransform(RotationMatrix.MakeXRotation(math.pi), np.zeros(3))
    return shape.lowest_point(RigidTransform()), -shape.lowest_point(upside_down)


def contact_heights(shape: ObjectShape, grip: str, lowest: float, spacing: float = math.inf) -> list[float]:
    """Returns heights of the grip to try, best first, as fractions of the object's height.

    Just above the middle is best, because the object then hangs from its contacts. If the fingertips do not
    reach so low, they touch the upper edge, and the fraction may be above 1. `lowest` is the least height of
    a fingertip's centre above the object's bottom, m; for `spacing` see `grip_contacts`.
    """
    main, X_OG = shape.main
    if isinstance(main, Sphere | Ellipsoid):
        shares: tuple[float, ...] = (0.5,)  # the surface is vertical only there
    else:
        shares = (0.55, 0.4, 0.75)
    bottom, top = vertical_extent(shape)
    centre, half = X_OG.translation()[2], half_extents(main)[2]
    raised = [level * min(spacing, _MAX_STEP) for _, level in GRIPS[grip].values()]
    fitting = []
    for share in shares:
        z = bottom + share * (top - bottom)
        on_main = z + max(raised) <= centre + half - _EDGE and z + min(raised) >= centre - half + _EDGE
        if on_main and z + min(raised) - bottom >= lowest:
            fitting.append(share)
    if fitting or isinstance(main, Sphere | Ellipsoid) or grip == PALM_GRIP:
        return fitting
    above_edges = [(lowest - lower, bottom + lowest - lower - (centre + half)) for lower in _LOWER]
    return [z / (top - bottom) for z, above in above_edges if -_EDGE < above <= _ABOVE_EDGE]


def finger_offsets(shape: ObjectShape, grip: str) -> tuple[float, ...]:
    """Returns distances of adjacent fingers from the middle of a flat side to try, best first, m.

    Round objects and grips without adjacent fingers have only one.
    """
    main, _ = shape.main
    alone = all(math.isclose(math.sin(angle), 0, abs_tol=1e-9) for angle, _ in GRIPS[grip].values())
    if alone or not isinstance(main, Box):
        return _OFFSETS[:1]
    # Boxes are grasped across their shorter side, see `yaw_candidates`.
    widest = max(main.width(), main.depth()) / 2 - _EDGE
    return _OFFSETS[:1] + tuple(offset for offset in _OFFSETS[1:] if offset <= widest)


def yaw_candidates(shape: ObjectShape) -> tuple[list[float], float]:
    """Returns yaws of the grip's axis to try, rad, and the object's yaw symmetry, rad (0: any angle)."""
    main, _ = shape.main
    if isinstance(main, Box):
        square = math.isclose(main.width(), main.depth(), rel_tol=0.02)
        yaws = [0.0, math.pi / 2, math.pi, -math.pi / 2] if square else [0.0, math.pi]
        if not square and main.width() > main.depth():
            yaws = [math.pi / 2, -math.pi / 2]
        return yaws, math.pi / 2 if square else math.pi
    is_round = not isinstance(main, Ellipsoid) or math.isclose(main.a(), main.b(), rel_tol=0.02)
    return [math.radians(a) for a in range(-180, 180, 30)], 0.0 if is_round else math.pi


def _radius_at(shape: Shape, direction: np.ndarray, z: float) -> float:
    """Returns the distance of an upright shape's surface from its axis, m.

    Args:
        direction: horizontal unit vector from the axis.
        z: height above the shape's centre, m.
    """
    if isinstance(shape, Ellipsoid):
        across = math.hypot(direction[0] / shape.a(), direction[1] / shape.b())
        return math.sqrt(max(1.0 - (z / shape.c()) ** 2, 0.0)) / across
    if hasattr(shape, "length"):
        return shape.radius()
    return math.sqrt(max(shape.radius() ** 2 - z**2, 0.0))


def _on_box(
    half: np.ndarray, X_OG: RigidTransform, direction: np.ndarray, yaw: float, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the contact in `direction` on a box's side across the grip's axis, and the outward normal."""
    axis = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    side = axis if direction @ axis > 0 else -axis
    lateral = np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    depth = float(np.abs(side) @ half)
    width = float(np.abs(lateral) @ half)
    # Adjacent fingertips keep their distance even on a narrow side.
    offset = float(np.clip(depth * (direction @ lateral) / abs(direction @ axis), -width, width))
    offset = 0.0 if abs(direction @ lateral) < 1e-9 else math.copysign(max(abs(offset), least), offset)
    return X_OG.translation() + depth * side + offset * lateral, side
