"""Reflects a human hand, because left hands are computed as mirrored right hands."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context

from geort_drake.people.keypoints import mirrored
from geort_drake.systems.port_values import mirrored_pose
from geort_drake.systems.python_system import PythonSystem


class HandMirror(PythonSystem):
    """Reflects keypoints in the xz-plane of H and the wrist's pose in the xz-plane of W.

    Input ports:
        keypoints (63): p_HK, keypoint-major, m.
        wrist_pose (abstract RigidTransform): X_WH.
    Output ports:
        keypoints (63): the reflected keypoints, same order.
        wrist_pose (abstract RigidTransform): the reflected pose.
    """

    def __init__(self) -> None:
        super().__init__()
        self._keypoints = self.DeclareVectorInputPort("keypoints", 63)
        self._wrist_pose = self.DeclareAbstractInputPort("wrist_pose", AbstractValue.Make(RigidTransform()))
        self.DeclareVectorOutputPort("keypoints", 63, self._calc_keypoints, {self._keypoints.ticket()})
        self.DeclareAbstractOutputPort(
            "wrist_pose",
            lambda: AbstractValue.Make(RigidTransform()),
            self._calc_wrist_pose,
            {self._wrist_pose.ticket()},
        )

    def _calc_keypoints(self, context: Context, output: BasicVector) -> None:
        p_HK = np.reshape(self._keypoints.Eval(context), (21, 3))
        output.SetFromVector(mirrored(p_HK).ravel())

    def _calc_wrist_pose(self, context: Context, output: AbstractValue) -> None:
        output.set_value(mirrored_pose(self._wrist_pose.Eval(context)))
