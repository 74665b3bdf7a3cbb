"""Between retargeting and a robot that moves: whether the person is engaged, and a glove that is lost."""

import dataclasses as dc
import math

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus, LeafSystem

from geort_drake.systems.glove_checks import FROZEN
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.retargeting_system import EASING, LIMITED, OUTSIDE, TRACKING, RetargetingStatus

_FOLLOWED = (TRACKING, LIMITED, OUTSIDE, EASING)
# The watchdog updates so long after the retargeting, s; who sends commands does it later than that.
AFTER = 1e-4
_PASSING, _RELAXING, _RETURNING = range(3)


@dc.dataclass
class WatchdogConfig:
    """What happens when the glove is lost while engaged."""

    # The hand holds for so long, s, and then relaxes. Infinite: it holds on.
    relax_after: float = 5.0
    # The largest joint speed on the way to the safe pose, rad/s.
    relax_speed: float = 0.5
    # Coming back, the speed limit grows from zero to full over this, s.
    ease_time: float = 0.5

    def validate(self) -> None:
        """Raises ValueError for values that cannot work."""
        for field in dc.fields(self):
            value = getattr(self, field.name)
            if not value > 0 or (math.isinf(value) and field.name != "relax_after"):
                raise ValueError(f"{field.name} must be positive and finite, not {value}")


class EngageSwitch(LeafSystem):
    """Lets the glove's word through while the person is engaged; else the hand counts as lost.

    Input ports:
        valid (1): the glove's.
        engaged (1): 1 engaged, 0 not.
    Output port:
        valid (1): 1 where both are.
    """

    def __init__(self) -> None:
        super().__init__()
        self._valid = self.DeclareVectorInputPort("valid", 1)
        self._engaged = self.DeclareVectorInputPort("engaged", 1)
        self.DeclareVectorOutputPort("valid", 1, self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, float(min(self._valid.Eval(context)[0], self._engaged.Eval(context)[0]) >= 0.5))


class Watchdog(LeafSystem):
    """Passes commands on; when the glove stays lost, takes the hand to a safe pose, and eases it back.

    RetargetingSystem holds at once when its input is lost, which is passed on. After `relax_after` the
    hand moves to the safe pose; when the input is followed again, it eases back to the commands, and when
    it has met two of them in a row, so that its velocity is theirs, they pass on. Disengaged, it never
    relaxes: a hold is what the person wants. All motions of its own keep the limits.

    Input ports:
        desired_state (2n): joint positions (rad), then velocities (rad/s), actuator order.
        status (abstract RetargetingStatus): of the retargeting.
        engaged (1): 1 engaged, 0 not.
    Output ports:
        desired_state (2n): the same, or the way to the safe pose and back.
        following (1): 1 while the person's hand is followed, 0 while it is held or relaxes.
        state (abstract str): what it does.

    State: q, v (n each) of its own way, the commands one update ago (n), mode, lost since and mode since (s).
    It updates `AFTER` the retargeting, so that it has the command of the same period.

    Args:
        limits: of the joints, in actuator order.
        safe_pose: (n,) rad.
        period: of the retargeting, s.

    Raises:
        ValueError: a value of the configuration cannot work.
    """

    def __init__(self, limits: JointLimits, safe_pose: np.ndarray, period: float, config: WatchdogConfig):
        super().__init__()
        config.validate()
        self._config, self._limits, self._period = config, limits, period
        self._relaxed = dc.replace(limits, speed=np.minimum(limits.speed, config.relax_speed))
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
        wanted = command[:n]
        value = context.get_discrete_state(self._state).value()
        q, v, before = value[:n], value[n : 2 * n], value[2 * n : 3 * n]
        mode, lost_since, since = value[3 * n :].tolist()
        engaged = self._engaged.Eval(context)[0] >= 0.5
        lost = engaged and _is_lost(self._status.Eval(context).state)
        if not lost:
            lost_since = math.nan
        elif math.isnan(lost_since):
            lost_since = time

        if mode == _PASSING:
            q, v = wanted, command[n:]
            if time - lost_since >= self._config.relax_after:  # False for NaN
                mode, since = _RELAXING, time
        else:
            if mode == _RELAXING and engaged and not lost:
                mode, since = _RETURNING, time
            elif mode == _RETURNING and lost:
                mode, since = _RELAXING, time
            if not engaged:
                q, v = self._limits.step(q, v, q, q, self._period)
                since = time  # so that coming back is eased from here
            elif mode == _RELAXING:
                q, v = self._relaxed.step(q, v, self._safe, self._safe, self._period)
            else:
                share = min((time - since + self._period) / self._config.ease_time, 1.0)
                met = np.array_equal(q, before)
                q, v = self._limits.step(q, v, wanted, before, self._period, share)
                if met and np.array_equal(q, wanted):
                    mode, since = _PASSING, time
        discrete_state.get_mutable_vector(self._state).SetFromVector(
            np.concatenate([q, v, wanted, [mode, lost_since, since]])
        )
        return EventStatus.Succeeded()

    def _calc_desired(self, context: Context, output: BasicVector) -> None:
        value = context.get_discrete_state(self._state).value()
        passing = value[3 * self._n] == _PASSING
        output.SetFromVector(self._desired.Eval(context) if passing else value[: 2 * self._n])

    def _calc_following(self, context: Context, output: BasicVector) -> None:
        followed = self._status.Eval(context).state in _FOLLOWED
        output.SetAtIndex(0, float(followed and self._engaged.Eval(context)[0] >= 0.5))

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
