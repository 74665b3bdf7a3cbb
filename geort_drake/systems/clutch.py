"""Turns a wrist's absolute pose into a target pose for the robot hand."""

import dataclasses as dc

from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, State

from geort_drake.systems.port_values import Immutable
from geort_drake.systems.python_system import PythonSystem


@dc.dataclass(frozen=True)
class _Engagement(Immutable):
    """Poses of wrist and hand when the clutch engaged; None while it is disengaged."""

    X_WH: RigidTransform | None = None
    X_WB: RigidTransform | None = None


class Clutch(PythonSystem):
    """Applies the wrist's motion since the clutch engaged to the robot hand.

    Person and robot may start at different poses: the wrist's translation and rotation since the first valid
    sample, both measured in W, are applied to the hand's pose at that time.

    Input ports:
        wrist_pose (abstract RigidTransform): X_WH.
        valid (1): 1 tracked, 0 lost. While lost, the target is the commanded pose, from which the clutch
            engages again, so the arm never jumps after a gap.
        commanded_pose (abstract RigidTransform): X_WB commanded to the arm.
    Output port:
        hand_pose (abstract RigidTransform): X_WB, the target of the hand.
    """

    def __init__(self, X_WB_start: RigidTransform, period: float):
        super().__init__()
        pose = AbstractValue.Make(RigidTransform())
        self._wrist = self.DeclareAbstractInputPort("wrist_pose", pose)
        self._valid = self.DeclareVectorInputPort("valid", 1)
        self._commanded = self.DeclareAbstractInputPort("commanded_pose", pose)
        self._target = self.DeclareAbstractState(AbstractValue.Make(X_WB_start))
        self._engagement = self.DeclareAbstractState(AbstractValue.Make(_Engagement()))
        self.DeclareStateOutputPort("hand_pose", self._target)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, state: State) -> EventStatus:
        target = state.get_mutable_abstract_state(self._target)
        engagement = state.get_mutable_abstract_state(self._engagement)
        # Copies, because Drake overwrites the values of ports and states.
        if self._valid.Eval(context)[0] < 0.5:
            engagement.set_value(_Engagement())
            target.set_value(RigidTransform(self._commanded.Eval(context)))
            return EventStatus.Succeeded()
        X_WH = self._wrist.Eval(context)
        start = engagement.get_value()
        if start.X_WH is None:
            start = _Engagement(RigidTransform(X_WH), RigidTransform(self._commanded.Eval(context)))
            engagement.set_value(start)
        p_WB = start.X_WB.translation() + X_WH.translation() - start.X_WH.translation()
        R_WB = X_WH.rotation() @ start.X_WH.rotation().inverse() @ start.X_WB.rotation()
        target.set_value(RigidTransform(R_WB, p_WB))
        return EventStatus.Succeeded()
