"""The retargeter as a system: human keypoints in, joint targets for the hand's PD controllers out."""

import dataclasses as dc
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from geort_drake.errors import HandError

TRACKING = "tracking"
HELD_LOST = "held: the glove lost the hand"
HELD_NOT_FINITE = "held: a keypoint or a joint target is not finite"
LIMITED = "limited: a joint is at its speed limit"
_STATES = (TRACKING, HELD_LOST, HELD_NOT_FINITE, LIMITED)


@dc.dataclass(frozen=True)
class RetargetingStatus:
    """What the system does with its input, and since which time (s)."""

    state: str = TRACKING
    since: float = 0.0


class RetargetingSystem(LeafSystem):
    """Retargets at a fixed period and holds its last target while the input cannot be used.

    A retargeter takes its time: what it makes of the keypoints comes out `latency` later. One that takes
    longer than the period is called again as soon as it is done, with the keypoints of that moment.

    Input ports:
        keypoints (63): p_HK, the 21 keypoints one after the other, m, wrist frame H.
        valid (1): 1 tracked, 0 lost.
    Output ports:
        desired_state (2n): joint positions (rad), then velocities (rad/s), in the order of
            `actuated_joints`, which is the plant's actuator order of the hand.
        status (abstract RetargetingStatus): what was held or limited, and since when.

    State: the 2n desired values last computed, the status with its start, and with a latency the 2n
    desired values last given out (discrete, so there is no direct feedthrough).

    Args:
        retarget: maps keypoints (21, 3) in H to joint positions (n,) in `joint_names` order.
        joint_names: the retargeter's joints.
        actuated_joints: the plant's actuated joints of the hand, in actuator order; each must be one
            of `joint_names`.
        initial_positions: joint name → rad, the targets before the first update.
        period: time between updates, s; no less than `latency` in effect.
        max_speed: joint speed limit of the targets, rad/s.
        latency: time from the keypoints to their joint targets, s.

    Raises:
        HandError: the plant's joints and the retargeter's are not the same set.
    """

    def __init__(
        self,
        retarget: Callable[[np.ndarray], np.ndarray],
        joint_names: Sequence[str],
        actuated_joints: Sequence[str],
        initial_positions: dict[str, float],
        period: float = 0.01,
        max_speed: float = 7.0,
        latency: float = 0.0,
    ):
        super().__init__()
        if set(joint_names) != set(actuated_joints):
            raise HandError(
                "the retargeter and the plant move different joints: the retargeter has "
                f"{', '.join(sorted(joint_names))}; the plant's hand has {', '.join(sorted(actuated_joints))}"
            )
        self._retarget = retarget
        self._to_plant = np.array([list(joint_names).index(name) for name in actuated_joints])
        self._period = period = max(period, latency)
        self._max_step = max_speed * period
        self._n = n = len(actuated_joints)
        self._keypoints_port = self.DeclareVectorInputPort("keypoints", 63)
        self._valid_port = self.DeclareVectorInputPort("valid", 1)
        q0 = np.array([initial_positions[name] for name in actuated_joints])
        desired = self.DeclareDiscreteState(np.concatenate([q0, np.zeros(n)]))
        self._status = self.DeclareDiscreteState(np.zeros(2))
        # With a latency, what is given out is kept apart from what is computed meanwhile.
        self._given_out = desired
        if latency > 0:
            self._given_out = self.DeclareDiscreteState(np.concatenate([q0, np.zeros(n)]))
        self.DeclareStateOutputPort("desired_state", self._given_out)
        self.DeclareAbstractOutputPort(
            "status",
            lambda: AbstractValue.Make(RetargetingStatus()),
            self._calc_status,
            {self.discrete_state_ticket(self._status)},
        )
        # Two events due at once would be at the mercy of rounding, so one that is busy all the time gives
        # out its last result when it takes up the next.
        self._busy = latency > period - 1e-9
        if latency > 0 and not self._busy:
            self.DeclarePeriodicDiscreteUpdateEvent(period, latency, self._give_out)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _give_out(self, context: Context, discrete_state) -> EventStatus:
        discrete_state.get_mutable_vector(self._given_out).SetFromVector(
            context.get_discrete_state(0).value()
        )
        return EventStatus.Succeeded()

    def _update(self, context: Context, discrete_state) -> EventStatus:
        if self._busy:
            self._give_out(context, discrete_state)
        before = context.get_discrete_state(0).value()[: self._n].copy()
        keypoints = self._keypoints_port.Eval(context)
        state = TRACKING
        after = before
        if self._valid_port.Eval(context)[0] < 0.5:
            state = HELD_LOST
        elif not np.isfinite(keypoints).all():
            state = HELD_NOT_FINITE
        else:
            wanted = self._retarget(keypoints.reshape(21, 3))[self._to_plant]
            if not np.isfinite(wanted).all():
                state = HELD_NOT_FINITE
            else:
                after = np.clip(wanted, before - self._max_step, before + self._max_step)
                if not np.array_equal(after, wanted):
                    state = LIMITED
        # The velocity target keeps the joint's damping from acting against a wanted motion.
        velocity = (after - before) / self._period
        discrete_state.get_mutable_vector(0).SetFromVector(np.concatenate([after, velocity]))
        code = float(_STATES.index(state))
        if context.get_discrete_state(self._status).value()[0] != code:
            discrete_state.get_mutable_vector(self._status).SetFromVector([code, context.get_time()])
        return EventStatus.Succeeded()

    def _calc_status(self, context: Context, output) -> None:
        code, since = context.get_discrete_state(self._status).value()
        output.set_value(RetargetingStatus(_STATES[int(code)], float(since)))
