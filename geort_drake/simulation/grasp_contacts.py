"""Where a grip touches an object, from the object's shape alone."""

import dataclasses as dc
import math

import numpy as np
from pydrake.geometry import Box, Ellipsoid, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.simulation.object_shape import ObjectShape

# In a tripod, index and middle stand this far to either side of the axis.
_SPREAD = math.radians(28)
# Fingers of each grip, and their angle around the vertical from the grip's axis; the first that the robot
# can do is taken.
GRIPS: dict[str, tuple[tuple[str, float], ...]] = {
    "tripod": (("thumb", math.pi), ("index", _SPREAD), ("middle", -_SPREAD)),
    "pinch": (("thumb", math.pi), ("index", 0.0)),
}
# Objects taller than this are first tried above their middle, m.
_TALL = 0.07


@dc.dataclass(frozen=True)
class Contact:
    """Where a finger shall touch: a surface point and the inward normal, in O, m."""

    finger: str
    p_OC: np.ndarray
    n_O: np.ndarray


def grip_contacts(shape: ObjectShape, yaw: float, height: float = 0.5, grip: str = "tripod") -> list[Contact]:
    """The contacts of a grip around the vertical at `yaw`, on the object's main part.

    Args:
        yaw: direction of the grasp's axis from the thumb to the fingers, rad.
        height: of the contacts, as a share of the object's height.
        grip: one of `GRIPS`.
    """
    main, X_OG = shape.main
    bottom, top = vertical_extent(shape)
    z = bottom + height * (top - bottom)
    contacts = []
    for finger, angle in GRIPS[grip]:
        direction = np.array([math.cos(yaw + angle), math.sin(yaw + angle), 0.0])
        if isinstance(main, Box):
            p, outward = _on_box(main.size() / 2, X_OG, direction, yaw, z)
        else:
            p, outward = direction * _radius_at(main, z - X_OG.translation()[2]), direction
            p = p + X_OG.translation() * [1, 1, 0]
        contacts.append(Contact(finger, np.array([p[0], p[1], z]), -outward))
    return contacts


def vertical_extent(shape: ObjectShape) -> tuple[float, float]:
    """Lowest and highest z of the upright object in O, m."""
    upside_down = RigidTransform(RotationMatrix.MakeXRotation(math.pi), np.zeros(3))
    return shape.lowest_point(RigidTransform()), -shape.lowest_point(upside_down)


def _radius_at(shape, z: float) -> float:
    """Radius of a round shape at the height z over its centre."""
    if hasattr(shape, "length"):
        return shape.radius()
    return math.sqrt(max(shape.radius() ** 2 - z**2, 0.0))


def _on_box(half: np.ndarray, X_OG: RigidTransform, direction: np.ndarray, yaw: float, z: float):
    """The side of a box that faces along the grasp's axis, and the point on it under `direction`."""
    axis = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    side = axis if direction @ axis > 0 else -axis
    lateral = np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    depth = float(np.abs(side) @ half)
    width = float(np.abs(lateral) @ half)
    # Neighbouring fingertips need room beside each other even on a narrow side.
    offset = float(np.clip(depth * (direction @ lateral) / abs(direction @ axis), -width, width))
    offset = 0.0 if abs(direction @ lateral) < 1e-9 else math.copysign(max(abs(offset), 0.014), offset)
    return X_OG.translation() + depth * side + offset * lateral, side


def contact_heights(shape: ObjectShape) -> tuple[float, ...]:
    """Heights to try for the contacts, best first, as shares of the object's height."""
    if isinstance(shape.main[0], Sphere | Ellipsoid):
        return (0.5,)  # elsewhere the surface is not upright
    bottom, top = vertical_extent(shape)
    return (0.6, 0.5, 0.7) if top - bottom > _TALL else (0.5, 0.6, 0.7)


def yaw_candidates(shape: ObjectShape) -> tuple[list[float], float]:
    """Yaws to try for the grasp's axis, and the object's own yaw symmetry (0: full)."""
    main, _ = shape.main
    if isinstance(main, Box):
        square = math.isclose(main.width(), main.depth(), rel_tol=0.02)
        yaws = [0.0, math.pi / 2, math.pi, -math.pi / 2] if square else [0.0, math.pi]
        if not square and main.width() > main.depth():
            yaws = [math.pi / 2, -math.pi / 2]
        return yaws, math.pi / 2 if square else math.pi
    return [math.radians(a) for a in range(-180, 180, 30)], 0.0
