"""The goal of a grasp: poses of the hand and contacts of the fingertips, relative to the object."""

import dataclasses as dc
import math

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.simulation.operators.goal import Goal


@dc.dataclass(frozen=True)
class GraspGoal(Goal):
    """A grasp of one object by one robot hand.

    Frames: O the object, upright, its x axis at the grasp's yaw; B the hand base; F a fingertip point. The
    clearance is the least distance between the fingers of the open hand and the object on the way to it.
    """

    # Pose of the hand base at the grasp, and while waiting before it, clear of the object.
    X_OB: RigidTransform
    X_OB_before: RigidTransform
    # (F, 3) fingertips of the open hand in B, m.
    p_BF_open: np.ndarray
    # (F, 3) touching fingertips in O, m, and inward unit vectors.
    p_OF_touch: np.ndarray
    n_OF: np.ndarray
    # Turn about the vertical after which the object looks the same, rad; 0 for any turn.
    yaw_symmetry: float

    def places(self) -> tuple[np.ndarray]:
        return (self.p_BF_open,)

    def object_frame(self, X_WO: RigidTransform) -> RigidTransform:
        """Returns the upright frame O of the grasp for an object at X_WO.

        Of equivalent yaws it has the one nearest to zero, so that the wrist turns least.
        """
        R = X_WO.rotation().matrix()
        yaw = math.atan2(R[1, 0], R[0, 0])
        yaw = 0.0 if self.yaw_symmetry == 0 else math.remainder(yaw, self.yaw_symmetry)
        return RigidTransform(RotationMatrix.MakeZRotation(yaw), X_WO.translation())
