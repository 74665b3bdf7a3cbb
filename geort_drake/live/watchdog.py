"""Engages and disengages the person, and relaxes the hand when the glove stays lost."""

import dataclasses as dc
import math

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus

from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.python_system import PythonSystem
from geort_drake.systems.retargeting_status import FOLLOWED, FROZEN, RetargetingStatus

# Delay of the watchdog's update after the retargeting's, s; commands are sent even later.
AFTER = 1e-4
_PASSING, _RELAXING, _RETURNING = range(3)


class EngageSwitch(PythonSystem):
    """Marks the hand as lost while the person is disengaged.

    Input ports:
        valid (1): 1 while the glove tracks the hand, 0 while it is lost.
        engaged (1): 1 engaged, 0 not.
    Output port:
        valid (1): 1 if both inputs are 1.
    """

    def __init__(self) -> None:
        super().__init__()
        self._valid = self.DeclareVectorInputPort("valid", 1)
        self._engaged = self.DeclareVectorInputPort("engaged", 1)
        self.DeclareVectorOutputPort("valid", 1, self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, float(min(self._valid.Eval(context)[0], self._engaged.Eval(context)[0]) >= 0.5))


class Watchdog(PythonSystem):
    """Passes commands; while the glove stays lost, moves the hand to a safe pose, and later eases it back.

    RetargetingSystem already holds when its input is lost. After `relax_after`, the watchdog moves the hand
    to the safe pose. When the input is followed again, it eases the hand back. It passes commands again once
    the hand has met two of them in a row, so that velocities agree. While the person is disengaged, the hand
    only holds. The watchdog's own motions respect the limits. It updates `AFTER` the retargeting, so that it
    has the command of the same period.

    Input ports:
        desired_state (2n): joint positions (rad), then velocities (rad/s), in actuator order.
        status (abstract RetargetingStatus): status of the retargeting.
        engaged (1): 1 engaged, 0 not.
    Output ports:
        desired_state (2n): the input, or the motion to the safe pose and back, in the same order and units.
        following (1): 1 while the person's hand is followed, 0 while the hand is held or relaxes.
        state (abstract str): what the hand does.

    State: positions and velocities (n each) of its own motion, the commands of the last update (n), the mode,
    and since when (s) the glove has been lost and the mode has been active.

    Args:
        limits: limits of the joints, in actuator order.
        safe_pose: (n,) joint positions, rad.
        period: period of the retargeting, s.
        relax_after: time for which a hand without a glove holds before it relaxes, s; infinity for ever.
        relax_speed: largest joint speed in the motion to the safe pose, rad/s.
        ease_time: time in which the speed limit grows from zero to full when the hand returns, s.

    Raises:
        ValueError: one of the last three is not positive, or one of the last two is infinite.
    """

    def __init__(
        self,
        limits: JointLimits,
        safe_pose: np.ndarray,
        period: float,
        relax_after: float = 5.0,
        relax_speed: float = 0.5,
        ease_time: float = 0.5,
    ):
        super().__init__()
        for name, value in (
            ("relax_after", relax_after),
            ("relax_speed", relax_speed),
            ("ease_time", ease_time),
        ):
            if not value > 0 or (math.isinf(value) and name != "relax_after"):
                raise ValueError(f"{name} must be positive and finite, not {value}")
        self._relax_after, self._ease_time = relax_after, ease_time
        self._limits, self._period = limits, period
        self._relaxed_limits = dc.replace(limits, speed=np.minimum(limits.speed, relax_speed))
        self._safe = np.clip(safe_pose, limits.lower, limits.upper)
        self._n = n = len(self._safe)
        self._desired = self.DeclareVectorInputPort("desired_state", 2 * n)
        self._status = self.DeclareAbstractInputPort("status", AbstractValue.Make(RetargetingStatus()))
        self._engaged = self.DeclareVectorInputPort("engaged", 1)
        self._state = self.DeclareDiscreteState(
            np.concatenate([self._safe, np.zeros(n), self._safe, [_PASSING, math.nan, 0.0]])
        )
        self.DeclareVectorOutputPort("desired_state", 2 * n, self._calc_desired)
        self.DeclareVectorOutputPort("following", 1, self._calc_following)
        self.DeclareAbstractOutputPort("state", lambda: AbstractValue.Make(""), self._calc_state)
        self.DeclarePeriodicDiscreteUpdateEvent(period, AFTER, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        n, time = self._n, context.get_time()
        command = self._desired.Eval(context)
        target = command[:n]
        value = context.get_discrete_state(self._state).value()
        q, v, target_before = value[:n], value[n : 2 * n], value[2 * n : 3 * n]
        mode, lost_since, since = value[3 * n :].tolist()
        engaged = self._engaged.Eval(context)[0] >= 0.5
        lost = engaged and _is_lost(self._status.Eval(context).state)
        if not lost:
            lost_since = math.nan
        elif math.isnan(lost_since):
            lost_since = time

        if mode == _PASSING:
            q, v = target, command[n:]
            if time - lost_since >= self._relax_after:  # False for NaN
                mode, since = _RELAXING, time
        else:
            if mode == _RELAXING and engaged and not lost:
                mode, since = _RETURNING, time
            elif mode == _RETURNING and lost:
                mode, since = _RELAXING, time
            if not engaged:
                q, v = self._limits.step(q, v, q, q, self._period)
                since = time  # the return is eased from this time
            elif mode == _RELAXING:
                q, v = self._relaxed_limits.step(q, v, self._safe, self._safe, self._period)
            else:
                share = min((time - since + self._period) / self._ease_time, 1.0)
                is_reached = np.array_equal(q, target_before)
                q, v = self._limits.step(q, v, target, target_before, self._period, share)
                if is_reached and np.array_equal(q, target):
                    mode, since = _PASSING, time
        discrete_state.get_mutable_vector(self._state).SetFromVector(
            np.concatenate([q, v, target, [mode, lost_since, since]])
        )
        return EventStatus.Succeeded()

    def _calc_desired(self, context: Context, output: BasicVector) -> None:
        value = context.get_discrete_state(self._state).value()
        passing = value[3 * self._n] == _PASSING
        output.SetFromVector(self._desired.Eval(context) if passing else value[: 2 * self._n])

    def _calc_following(self, context: Context, output: BasicVector) -> None:
        is_followed = self._status.Eval(context).state in FOLLOWED
        output.SetAtIndex(0, float(is_followed and self._engaged.Eval(context)[0] >= 0.5))

    def _calc_state(self, context: Context, output: AbstractValue) -> None:
        mode = context.get_discrete_state(self._state).value()[3 * self._n]
        if self._engaged.Eval(context)[0] < 0.5:
            output.set_value("disengaged: held")
        elif mode == _RELAXING:
            output.set_value("relaxing: the glove has been lost for too long")
        elif mode == _RETURNING:
            output.set_value("returning: the hand comes back to the glove")
        else:
            output.set_value(self._status.Eval(context).state)


def _is_lost(state: str) -> bool:
    return state.startswith("held") or state == FROZEN
