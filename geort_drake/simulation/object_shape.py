"""The shape of an object, as the planner and the monitor need it, read from its model."""

import dataclasses as dc

import numpy as np
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Role, SceneGraphInspector, Shape, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from geort_drake.errors import ScenarioError

CONVEX_PRIMITIVES = (Box, Capsule, Cylinder, Ellipsoid, Sphere)


@dc.dataclass(frozen=True)
class ObjectShape:
    """Convex primitives fixed in the object's frame O."""

    parts: tuple[tuple[Shape, RigidTransform], ...]

    @property
    def main(self) -> tuple[Shape, RigidTransform]:
        """The largest part by bounding volume, with its pose in O."""
        return max(self.parts, key=lambda part: float(np.prod(half_extents(part[0]))))

    def lowest_point(self, X_WO: RigidTransform) -> float:
        """Height in W of the lowest point of the object at X_WO, m."""
        return min(_lowest(shape, X_WO @ X_OG) for shape, X_OG in self.parts)


def object_shape(plant: MultibodyPlant, inspector: SceneGraphInspector, body: RigidBody) -> ObjectShape:
    """Reads the collision geometry of `body`.

    Raises:
        ScenarioError: the body has no collision geometry, or one that is no convex primitive.
    """
    frame = plant.GetBodyFrameIdOrThrow(body.index())
    parts = tuple(
        (inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry))
        for geometry in inspector.GetGeometries(frame, Role.kProximity)
    )
    kinds = [type(shape).__name__ for shape, _ in parts]
    if not parts or not all(isinstance(shape, CONVEX_PRIMITIVES) for shape, _ in parts):
        choices = ", ".join(kind.__name__ for kind in CONVEX_PRIMITIVES)
        raise ScenarioError(
            f"object '{body.name()}' needs collision geometry made of {choices}; it has: "
            f"{', '.join(kinds) or 'none'}"
        )
    return ObjectShape(parts)


def half_extents(shape: Shape) -> np.ndarray:
    """Half the sides of the box around a primitive, along its own axes, (3,) m."""
    if isinstance(shape, Box):
        return shape.size() / 2
    if isinstance(shape, Cylinder):
        return np.array([shape.radius(), shape.radius(), shape.length() / 2])
    if isinstance(shape, Capsule):
        return np.array([shape.radius(), shape.radius(), shape.length() / 2 + shape.radius()])
    if isinstance(shape, Ellipsoid):
        return np.array([shape.a(), shape.b(), shape.c()])
    return np.full(3, shape.radius())


def _lowest(shape: Shape, X_WG: RigidTransform) -> float:
    """Height of the shape's lowest point: its centre less the support in the direction of −z."""
    down_G = X_WG.rotation().matrix()[2]  # the world's z axis in G
    half = half_extents(shape)
    if isinstance(shape, Box):
        reach = float(np.abs(down_G) @ half)
    elif isinstance(shape, Cylinder):
        reach = abs(down_G[2]) * half[2] + half[0] * float(np.hypot(down_G[0], down_G[1]))
    elif isinstance(shape, Capsule):
        reach = abs(down_G[2]) * shape.length() / 2 + shape.radius()
    else:
        reach = float(np.linalg.norm(down_G * half))
    return float(X_WG.translation()[2]) - reach
