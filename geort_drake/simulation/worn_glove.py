"""Measurement faults of a worn glove and tracker: misalignment, shift, and gaps."""

import bisect
import dataclasses as dc

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import BasicVector, Context
from scipy.spatial.transform import Rotation

from geort_drake.systems.python_system import PythonSystem


@dc.dataclass
class WornGloveConfig:
    """Faults of a glove and a tracker; their directions and times are drawn for each trial."""

    # Angle between the tracker's frame and the world's, about a random axis, rad.
    misalignment: float = 0.0
    # Standard deviations of a shift of all keypoints along each axis of the wrist, m, and of their rotation
    # about it, rad, for a glove that sits differently than in training.
    shift: float = 0.0
    turn: float = 0.0
    # Gaps in which the hand is lost: mean number per second, and duration, s.
    dropout_rate: float = 0.0
    dropout_time: float = 0.04


class WornGlove(PythonSystem):
    """Adds the configured faults to the measurements of a glove and a tracker.

    Input ports:
        keypoints (63): p_HK, keypoint-major, m, true wrist frame H.
        wrist_pose (abstract RigidTransform): X_WH.
        valid (1): 1 tracked, 0 lost.
    Output ports:
        keypoints (63): p_HK rotated and shifted; the wrist stays at the origin.
        wrist_pose (abstract RigidTransform): X_TH, in the misaligned frame T of the tracker.
        valid (1): 0 also during a gap.

    Args:
        duration: gaps are drawn up to this time, s.
        rng: draws all faults.
    """

    def __init__(self, config: WornGloveConfig, duration: float, rng: np.random.Generator):
        super().__init__()
        axis = rng.normal(size=3)
        R = Rotation.from_rotvec(config.misalignment * axis / np.linalg.norm(axis)).as_matrix()
        self._X_TW = RigidTransform(RotationMatrix(R), np.zeros(3))
        self._R = Rotation.from_rotvec(rng.normal(0, config.turn, 3)).as_matrix()
        self._p = rng.normal(0, config.shift, 3)
        # Given their number, the events of a Poisson process are distributed uniformly.
        count = rng.poisson(config.dropout_rate * duration)
        self._gaps, self._gap = sorted(rng.uniform(0, duration, count).tolist()), config.dropout_time
        keypoints = self.DeclareVectorInputPort("keypoints", 63)
        wrist = self.DeclareAbstractInputPort("wrist_pose", AbstractValue.Make(RigidTransform()))
        valid = self.DeclareVectorInputPort("valid", 1)

        def calc_keypoints(context: Context, output: BasicVector) -> None:
            p_HK = keypoints.Eval(context).reshape(21, 3) @ self._R.T + self._p
            p_HK[0] = 0.0
            output.SetFromVector(p_HK.ravel())

        def calc_valid(context: Context, output: BasicVector) -> None:
            output.SetAtIndex(0, 0.0 if self._in_gap(context.get_time()) else valid.Eval(context)[0])

        self.DeclareVectorOutputPort("keypoints", 63, calc_keypoints, {keypoints.ticket()})
        self.DeclareAbstractOutputPort(
            "wrist_pose",
            lambda: AbstractValue.Make(RigidTransform()),
            lambda context, output: output.set_value(self._X_TW @ wrist.Eval(context)),
            {wrist.ticket()},
        )
        self.DeclareVectorOutputPort("valid", 1, calc_valid, {valid.ticket(), self.time_ticket()})

    def _in_gap(self, t: float) -> bool:
        count = bisect.bisect_right(self._gaps, t)
        return count > 0 and t < self._gaps[count - 1] + self._gap
