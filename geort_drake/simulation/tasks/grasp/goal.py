"""What a person wants the robot hand to do with an object: where to be, and where to touch."""

import dataclasses as dc
import math

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.people.keypoints import mirrored
from geort_drake.systems.port_values import mirrored_pose


@dc.dataclass(frozen=True)
class GraspGoal:
    """A grasp of one object by one robot hand, relative to the object.

    Frames: O the object, upright, its x axis at the grasp's yaw; B the hand base; F a fingertip point.
    The goal knows the object and the robot and nothing of how the hand is driven.
    """

    # Robot fingers, in the hand description's order.
    finger_names: tuple[str, ...]
    # Whether each finger shall touch; the others only keep their place.
    touches: np.ndarray
    # Hand base at the grasp, and before it, clear of the object.
    X_OB: RigidTransform
    X_OB_before: RigidTransform
    # Fingertip points in B of the opened hand, (F, 3) m.
    p_BF_open: np.ndarray
    # Fingertip points in O when touching, (F, 3) m, and the unit direction inwards, (F, 3).
    p_OF_touch: np.ndarray
    n_OF: np.ndarray
    # Turning the object by this angle about its vertical gives the same grasp, rad; 0: by any angle.
    yaw_symmetry: float

    def mirrored(self) -> "GraspGoal":
        """The same grasp in the mirror, in which a left hand is a right one: everything with y negated."""
        return dc.replace(
            self,
            X_OB=mirrored_pose(self.X_OB),
            X_OB_before=mirrored_pose(self.X_OB_before),
            p_BF_open=mirrored(self.p_BF_open),
            p_OF_touch=mirrored(self.p_OF_touch),
            n_OF=mirrored(self.n_OF),
        )

    def object_frame(self, X_WO: RigidTransform) -> RigidTransform:
        """The upright frame O of the grasp for an object seen at X_WO.

        Of all equivalent yaws the one nearest to zero is taken, so that the wrist turns least.
        """
        R = X_WO.rotation().matrix()
        yaw = math.atan2(R[1, 0], R[0, 0])
        yaw = 0.0 if self.yaw_symmetry == 0 else math.remainder(yaw, self.yaw_symmetry)
        return RigidTransform(RotationMatrix.MakeZRotation(yaw), X_WO.translation())
