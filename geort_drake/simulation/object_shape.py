"""Reads the shape of an object from its model, as convex primitives."""

import functools

import numpy as np
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, SceneGraphInspector, Shape, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from geort_drake.errors import ScenarioError

CONVEX_PRIMITIVES = (Box, Capsule, Cylinder, Ellipsoid, Sphere)


class ObjectShape:
    """Convex primitives G fixed in an object's frame O: the collision geometry of its body.

    Attributes:
        parts: the primitives, with their poses X_OG.

    Raises:
        ScenarioError: the body has no collision geometry, or geometry other than convex primitives.
    """

    def __init__(self, plant: MultibodyPlant, inspector: SceneGraphInspector, body: RigidBody):
        # Copies, which do not keep the scene graph alive.
        self.parts: tuple[tuple[Shape, RigidTransform], ...] = tuple(
            (inspector.GetShape(geometry).Clone(), RigidTransform(inspector.GetPoseInFrame(geometry)))
            for geometry in plant.GetCollisionGeometriesForBody(body)
        )
        kinds = [type(shape).__name__ for shape, _ in self.parts]
        if not self.parts or not all(isinstance(shape, CONVEX_PRIMITIVES) for shape, _ in self.parts):
            choices = ", ".join(kind.__name__ for kind in CONVEX_PRIMITIVES)
            raise ScenarioError(
                f"object '{body.name()}' needs collision geometry made of {choices}; it has: "
                f"{', '.join(kinds) or 'none'}"
            )

    @property
    def main(self) -> tuple[Shape, RigidTransform]:
        """The largest part by bounding box, with its pose X_OG."""
        return max(self.parts, key=lambda part: float(np.prod(half_extents(part[0]))))

    def lowest_point(self, X_WO: RigidTransform) -> float:
        """Height in W of the lowest point of the object at X_WO, m."""
        R_OG, p_OG, box, disk, ellipsoid = self._minkowski_summands
        down_O = X_WO.rotation().matrix()[2]  # the world's z axis in O
        down_G = down_O @ R_OG
        reach = (np.abs(down_G) * box).sum(axis=1)
        reach += disk * np.hypot(down_G[:, 0], down_G[:, 1])
        reach += np.sqrt(((down_G * ellipsoid) ** 2).sum(axis=1))
        return float(X_WO.translation()[2] + (p_OG @ down_O - reach).min())

    @functools.cached_property
    def _minkowski_summands(self) -> tuple[np.ndarray, ...]:
        """Poses R_OG (N, 3, 3) and p_OG (N, 3) of the N parts, and the Minkowski summands of each.

        The summands are boxes of half sides (N, 3), disks of radius (N,) across z, and ellipsoids of half
        axes (N, 3). The support function of a sum is the sum of the support functions.
        """
        poses = [X_OG for _, X_OG in self.parts]
        box, disk, ellipsoid = zip(*(_summands(shape) for shape, _ in self.parts), strict=True)
        return (
            np.array([X.rotation().matrix() for X in poses]),
            np.array([X.translation() for X in poses]),
            np.array(box),
            np.array(disk),
            np.array(ellipsoid),
        )


def half_extents(shape: Shape) -> np.ndarray:
    """Returns half the sides (3,) of a primitive's bounding box along its own axes, m."""
    box, disk, ellipsoid = _summands(shape)
    return box + [disk, disk, 0.0] + ellipsoid


def _summands(shape: Shape) -> tuple[np.ndarray, float, np.ndarray]:
    """Returns a box's half sides, a disk's radius and an ellipsoid's half axes whose sum is the shape."""
    nothing = np.zeros(3)
    if isinstance(shape, Box):
        return shape.size() / 2, 0.0, nothing
    if isinstance(shape, Ellipsoid):
        return nothing, 0.0, np.array([shape.a(), shape.b(), shape.c()])
    if isinstance(shape, Cylinder):
        return np.array([0.0, 0.0, shape.length() / 2]), shape.radius(), nothing
    if isinstance(shape, Capsule):
        return np.array([0.0, 0.0, shape.length() / 2]), 0.0, np.full(3, shape.radius())
    return nothing, 0.0, np.full(3, shape.radius())
