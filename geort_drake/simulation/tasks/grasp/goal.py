"""The goal of a grasp: poses of the hand and contacts of the fingertips, relative to the object."""

import dataclasses as dc
import math

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.people.keypoints import mirrored
from geort_drake.simulation.operators.perception import FreePlay
from geort_drake.systems.port_values import mirrored_pose


@dc.dataclass(frozen=True)
class GraspGoal:
    """A grasp of one object by one robot hand.

    Frames: O the object, upright, its x axis at the grasp's yaw; B the hand base; F a fingertip point.
    """

    # Robot fingers, in the hand description's order.
    finger_names: tuple[str, ...]
    # (F,) whether each finger touches the object.
    touches: np.ndarray
    # Hand base at the grasp, and before it, clear of the object.
    X_OB: RigidTransform
    X_OB_before: RigidTransform
    # Least distance between the fingers of the open hand and the object on the way between the two, m: the
    # fingertips may be as far from their places.
    clearance: float
    # (F, 3) fingertip points of the open hand in B, m.
    p_BF_open: np.ndarray
    # (F, 3) fingertip points in O when touching, m, and unit vectors inwards.
    p_OF_touch: np.ndarray
    n_OF: np.ndarray
    # The grasp is the same for an object turned about its vertical by this angle, rad; 0: by any angle.
    yaw_symmetry: float
    # What the person saw before, if it matters.
    play: FreePlay | None = None

    def mirrored(self) -> "GraspGoal":
        """Returns the grasp reflected in the xz-planes of its frames; the person's own hand is not."""
        return dc.replace(
            self,
            X_OB=mirrored_pose(self.X_OB),
            X_OB_before=mirrored_pose(self.X_OB_before),
            p_BF_open=mirrored(self.p_BF_open),
            p_OF_touch=mirrored(self.p_OF_touch),
            n_OF=mirrored(self.n_OF),
            play=self.play and self.play._replace(p_BF=mirrored(self.play.p_BF)),
        )

    def object_frame(self, X_WO: RigidTransform) -> RigidTransform:
        """The upright frame O of the grasp for an object at X_WO.

        Its yaw is the equivalent one nearest to zero, so the wrist turns least.
        """
        R = X_WO.rotation().matrix()
        yaw = math.atan2(R[1, 0], R[0, 0])
        yaw = 0.0 if self.yaw_symmetry == 0 else math.remainder(yaw, self.yaw_symmetry)
        return RigidTransform(RotationMatrix.MakeZRotation(yaw), X_WO.translation())
