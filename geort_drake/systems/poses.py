"""Poses as vector ports carry them: qw qx qy qz x y z."""

import math

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix


def pose_to_vector(X: RigidTransform) -> np.ndarray:
    """qw qx qy qz x y z of a pose, (7,)."""
    return np.concatenate([X.rotation().ToQuaternion().wxyz(), X.translation()])


# What a reflection in the xz-plane makes of a point, and of a pose as a vector: the rotation's axis is an
# axial vector, which turns round besides.
POINT_MIRROR = np.array([1.0, -1.0, 1.0])
POSE_MIRROR = np.array([1.0, -1.0, 1.0, -1.0, *POINT_MIRROR])


def mirrored_pose(X: RigidTransform) -> RigidTransform:
    """The pose that both frames' reflections in their xz-planes have to each other."""
    return vector_to_pose(POSE_MIRROR * pose_to_vector(X))


def vector_to_pose(values: np.ndarray) -> RigidTransform:
    """The pose behind qw qx qy qz x y z, (7,); the quaternion is normalised."""
    values = np.asarray(values, float)
    quaternion = values[:4]
    unit = quaternion / math.sqrt(quaternion.dot(quaternion))
    return RigidTransform(RotationMatrix(Quaternion(unit)), values[4:])
