"""Decides at every update whether a tracker's wrist pose can be followed."""

import math

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus

from geort_drake.systems.port_values import pose_to_vector
from geort_drake.systems.python_system import PythonSystem

WRIST_JUMPED = "held: the wrist moved faster than a wrist can"
WRIST_NOT_FINITE = "held: the wrist's pose is not finite"
_STATES = ("", WRIST_JUMPED, WRIST_NOT_FINITE)

# s; the allowed jump grows with the time between poses, up to this gap, the longest of common trackers.
_MAX_GAP = 0.04
_TIME_TOLERANCE = 1e-9  # s; for rounding errors in sums of periods
# Faster motions are not followed; the arm could not follow them, either.
_MAX_SPEED = 3.0  # m/s
_MAX_ROTATION_SPEED = 20.0  # rad/s; a MANUS recording at 118 Hz peaks at 8
# The pose must be good for this long before it is followed again, s.
_SETTLE_TIME = 0.1


class WristChecks(PythonSystem):
    """Marks the wrist as lost while its pose is not finite or moves faster than a wrist can.

    After a jump, poses are compared with the new one. If the tracker stays there, it is followed again after
    the settling time; `Clutch` applies only the motion from then on.

    Input ports:
        wrist_pose (abstract RigidTransform): X_WH.
        valid (1): 1 tracked, 0 lost.
    Output ports:
        valid (1): 1 if the input `valid` is 1 and the pose can be followed.
        state (abstract str): why the pose cannot be followed, or empty, regardless of the input `valid`.

    State: the last pose as qw qx qy qz x y z, when it changed (s), when it was last bad (s), and the index of
    the state.
    """

    def __init__(self, period: float):
        super().__init__()
        self._period = period
        self._wrist = self.DeclareAbstractInputPort("wrist_pose", AbstractValue.Make(RigidTransform()))
        self._valid = self.DeclareVectorInputPort("valid", 1)
        self._memory = self.DeclareDiscreteState(np.array([*[math.nan] * 7, 0.0, -math.inf, 0.0]))
        # Computed from the present pose, so that it is checked before other systems use it.
        self.DeclareVectorOutputPort("valid", 1, self._calc_valid)
        self.DeclareAbstractOutputPort("state", lambda: AbstractValue.Make(""), self._calc_state)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _judge(self, context: Context) -> tuple[np.ndarray, str]:
        """Returns the updated memory (10,) and the state."""
        time = context.get_time()
        memory = context.get_discrete_state(self._memory).value()
        last, (changed, bad_since, code) = memory[:7], memory[7:].tolist()
        X_WH = self._wrist.Eval(context)
        if not np.isfinite(X_WH.GetAsMatrix34()).all():
            return np.array([*last, changed, time, _STATES.index(WRIST_NOT_FINITE)]), WRIST_NOT_FINITE
        pose = pose_to_vector(X_WH)
        if time - bad_since >= _SETTLE_TIME - _TIME_TOLERANCE:
            code = 0
        if not np.array_equal(pose, last):
            gap = max(min(time - changed, _MAX_GAP), self._period)
            # |q · q'| is the cosine of half the angle. Before the first pose, comparisons with NaN are false.
            angle = 2.0 * math.acos(min(abs(float(pose[:4] @ last[:4])), 1.0))
            distance = float(np.linalg.norm(pose[4:] - last[4:]))
            if distance > _MAX_SPEED * gap or angle > _MAX_ROTATION_SPEED * gap:
                code, bad_since = _STATES.index(WRIST_JUMPED), time
            changed = time
        return np.array([*pose, changed, bad_since, code]), _STATES[int(code)]

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        discrete_state.get_mutable_vector(self._memory).SetFromVector(self._judge(context)[0])
        return EventStatus.Succeeded()

    def _calc_valid(self, context: Context, output: BasicVector) -> None:
        good = self._valid.Eval(context)[0] >= 0.5 and not self._judge(context)[1]
        output.SetAtIndex(0, float(good))

    def _calc_state(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._judge(context)[1])
