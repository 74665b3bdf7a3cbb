"""Integrates the arm's joint velocities into commanded positions, or brakes and holds the arm."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context, DiscreteValues, EventStatus

from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.python_system import PythonSystem


class ArmMotion(PythonSystem):
    """Integrates joint velocities while the wrist is followed; otherwise brakes the joints and holds them.

    Input ports:
        velocity (m): velocities of the plant's active joints, rad/s.
        valid (1): 1 follow, 0 hold.
    Output ports:
        arm_desired_state (2na): the arm's commanded joint positions (rad), then velocities (rad/s).
        positions (nq): positions of all joints of the plant, rad, the arm's as commanded.
        hand_pose (abstract RigidTransform): X_WB at these positions.

    State: the values of `arm_desired_state` and `positions`.

    Args:
        plant: robot and surroundings.
        positions: (nq,) initial positions, rad; inactive joints keep them.
        active: (nq,) bool, the joints of the `velocity` input.
        arm: (na,) position indices of the arm's joints; each is active.
        hand_frame: frame B of the hand.
        limits: limits of the arm's joints; braking always respects them.
        period: time between updates, s.
        limited: whether following respects the limits, too.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        positions: np.ndarray,
        active: np.ndarray,
        arm: np.ndarray,
        hand_frame: Frame,
        limits: JointLimits,
        period: float,
        limited: bool,
    ):
        super().__init__()
        self._plant, self._hand_frame = plant, hand_frame
        self._scratch = plant.CreateDefaultContext()
        self._active, self._arm = np.flatnonzero(active), arm
        self._arm_of_active = np.searchsorted(self._active, arm)
        self._limits, self._period, self._limited = limits, period, limited
        self._velocity = self.DeclareVectorInputPort("velocity", len(self._active))
        self._valid = self.DeclareVectorInputPort("valid", 1)
        self._desired = self.DeclareDiscreteState(np.concatenate([positions[arm], np.zeros(len(arm))]))
        self._positions = self.DeclareDiscreteState(positions)
        self.DeclareStateOutputPort("arm_desired_state", self._desired)
        self.DeclareStateOutputPort("positions", self._positions)
        self.DeclareAbstractOutputPort(
            "hand_pose",
            lambda: AbstractValue.Make(RigidTransform()),
            self._calc_hand_pose,
            {self.discrete_state_ticket(self._positions)},
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        desired = discrete_state.get_mutable_value(self._desired)
        positions = discrete_state.get_mutable_value(self._positions)
        n = len(self._arm)
        q, v = desired[:n].copy(), desired[n:].copy()
        if self._valid.Eval(context)[0] < 0.5:
            q, v = self._limits.step(q, v, q, q, self._period)
            positions[self._arm] = q
        else:
            velocity = self._velocity.Eval(context)
            before = positions[self._arm]
            positions[self._active] += self._period * velocity
            if self._limited:
                q, v = self._limits.step(q, v, positions[self._arm], before, self._period)
            else:
                q, v = positions[self._arm], velocity[self._arm_of_active]
        desired[:n], desired[n:] = q, v
        return EventStatus.Succeeded()

    def _calc_hand_pose(self, context: Context, output: AbstractValue) -> None:
        self._plant.SetPositions(self._scratch, context.get_discrete_state(self._positions).value())
        output.set_value(self._hand_frame.CalcPoseInWorld(self._scratch))
