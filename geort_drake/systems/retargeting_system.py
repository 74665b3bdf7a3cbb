"""Runs a retargeter as a system, from human keypoints to targets of joint controllers."""

import dataclasses as dc
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, DiscreteValues, EventStatus, State

from geort_drake.errors import HandError
from geort_drake.retargeting.numpy_retargeter import Retargeter
from geort_drake.retargeting.universal import UniversalRetargeter
from geort_drake.systems.glove_checks import (
    FROZEN,
    HELD_NOT_FINITE,
    Easing,
    GloveChecks,
    GloveMemory,
    find_fault,
)
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.person_following import OBSERVATION_PERIOD, PersonFollowing
from geort_drake.systems.python_system import PythonSystem
from geort_drake.systems.retargeting_status import (
    EASING,
    FOLLOWED,
    HELD_OTHER_PERSON,
    LIMITED,
    OUTSIDE,
    SETTLING,
    STATES,
    TRACKING,
    RetargetingStatus,
)
from geort_drake.systems.update_timing import check_timing, low_pass_factor

# A point moves at most this many times as far as its fastest coordinate.
_DIAGONAL = math.sqrt(3.0)
_ROUNDING = 1e-9  # m; rounding error of distances


class RetargetingSystem(PythonSystem):
    """Maps keypoints to joint targets at a fixed period; the output respects the limits for any input.

    While the input cannot be followed, the joints brake and hold. Then the hand follows again, at a growing
    speed limit. Joint targets appear `latency` after their keypoints. A retargeter that takes longer than the
    period is called again as soon as it is done, with the latest keypoints. A universal map adapts to the
    person: it observes the followed hand periodically and updates the person's code.

    Input ports:
        keypoints (63): p_HK, keypoint-major, m, wrist frame H.
        valid (1): 1 tracked, 0 lost.
        stamp (1), optional: time of measurement of the keypoints, s, on the glove's clock.
    Output ports:
        desired_state (2n): joint positions (rad), then velocities (rad/s), in the order of `actuated_joints`.
        status (abstract RetargetingStatus): what was held or limited, and since when.

    There is no direct feedthrough. The status `OUTSIDE` needs a retargeter with a `trained_space`.

    Attributes:
        period: time between updates, s.
        delay: from keypoints to their joint targets, s: the latency plus the low-pass filter's delay of slow
            motion.

    State: the last computed desired state (2n); memory of targets, input and status; with a latency, the
    desired state (2n) of the output port; and, for a universal map, an abstract `PersonFollowing`.

    Args:
        retarget: a `UniversalRetargeter`, or a function from keypoints (21, 3), m in H, to joint positions
            (n,), rad, in the order of `joint_names`. If it raises an exception, the simulation ends.
        joint_names: the retargeter's joints.
        actuated_joints: the same joints in actuator order.
        initial_positions: joint name → rad, the targets before the first update; 0 for a joint without one.
        period: time between updates, s, from 1e-5 to 10; raised to `latency` if that is longer.
        limits: limits of the targets, in actuator order. None takes the retargeter's `lower` and `upper`, and
            the default speed and acceleration of `JointLimits`.
        latency: time from keypoints to their joint targets, s, at most 10.
        checks: thresholds of the input checks.
        cutoff: cutoff frequency of a first-order low-pass on the targets, Hz; 0 for none.

    Raises:
        HandError: the actuated joints are not the retargeter's, the joint limits are unknown or of
            other joints, or an initial position is outside them; while it runs, `retarget` returned another
            shape.
        ValueError: a value of `checks`, or the period, latency or cutoff is out of range.
    """

    def __init__(
        self,
        retarget: Callable[[np.ndarray], np.ndarray],
        joint_names: Sequence[str],
        actuated_joints: Sequence[str],
        initial_positions: Mapping[str, float],
        period: float = 0.01,
        limits: JointLimits | None = None,
        latency: float = 0.0,
        checks: GloveChecks | None = None,
        cutoff: float = 0.0,
    ):
        super().__init__()
        if sorted(joint_names) != sorted(actuated_joints):
            raise HandError(
                "the retargeter and the plant move different joints: the retargeter has "
                f"{', '.join(sorted(joint_names))}; the plant's hand has {', '.join(sorted(actuated_joints))}"
            )
        self._checks = checks or GloveChecks()
        self._checks.validate()
        check_timing(period, latency, cutoff)
        self._retarget = retarget
        self._to_plant = np.array([list(joint_names).index(name) for name in actuated_joints])
        self._trained_space = getattr(retarget, "trained_space", None)
        self._limits = limits or self._limits_of(retarget)
        self.period = period = max(period, latency)
        self._blend = low_pass_factor(cutoff, period)
        self.delay = latency + period * (1.0 - self._blend) / self._blend
        self._n = n = len(actuated_joints)
        self._zeros = np.zeros(n)
        self._keypoints_port = self.DeclareVectorInputPort("keypoints", 63)
        self._valid_port = self.DeclareVectorInputPort("valid", 1)
        self._stamp_port = self.DeclareVectorInputPort("stamp", 1)
        q0 = self._limits.start(initial_positions, actuated_joints)
        desired = self.DeclareDiscreteState(np.concatenate([q0, np.zeros(n)]))
        easing = Easing.at_start(self._checks.ease_at_start)
        numbers = [STATES.index(SETTLING), 0.0, math.nan, 0.0, math.nan, 0.0, *dc.astuple(easing)]
        memory = self.DeclareDiscreteState(np.concatenate([q0, np.full(63, math.nan), numbers]))
        self._memory = int(memory)  # which pydrake converts sooner
        # With a latency, the output port has its own state.
        self._output = desired
        if latency > 0:
            self._output = self.DeclareDiscreteState(np.concatenate([q0, np.zeros(n)]))
        self.DeclareStateOutputPort("desired_state", self._output)
        tickets = {self.discrete_state_ticket(memory)}
        self._person = None
        if isinstance(retarget, UniversalRetargeter):
            start = AbstractValue.Make(PersonFollowing.start(retarget))
            self._person = self.DeclareAbstractState(start)
            tickets.add(self.abstract_state_ticket(self._person))
            self.DeclarePeriodicUnrestrictedUpdateEvent(max(OBSERVATION_PERIOD, period), 0.0, self._observe)
        self.DeclareAbstractOutputPort(
            "status", lambda: AbstractValue.Make(RetargetingStatus()), self._calc_status, tickets
        )
        # The order of two simultaneous events would depend on rounding, so with a latency of one period the
        # update itself outputs the last result.
        self._latency_is_period = latency > period - 1e-9
        if latency > 0 and not self._latency_is_period:
            self.DeclarePeriodicDiscreteUpdateEvent(period, latency, self._output_result)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _limits_of(self, retarget: Callable) -> JointLimits:
        lower, upper = getattr(retarget, "lower", None), getattr(retarget, "upper", None)
        if lower is None or upper is None:
            raise HandError("the joint limits are unknown: give `limits`, as the retargeter has none")
        return JointLimits(lower[self._to_plant], upper[self._to_plant])

    def change_map(self, context: Context, retargeter: Retargeter) -> bool:
        """Replaces the map by one that was fitted to the person, until another person is seen.

        Targets do not jump: the output fades to the new map within `FADE_TIME`.

        Returns:
            Whether the map was replaced; only a universal map can be replaced.

        Raises:
            HandError: the new map moves other joints.
        """
        person = self._get_person(context)
        if person is None:
            return False
        if retargeter.joint_names != person.universal.joint_names:
            raise HandError(f"the map moves other joints: {', '.join(retargeter.joint_names)}")
        person = person.taking(retargeter, context.get_time())
        context.get_mutable_abstract_state(self._person).set_value(person)
        return True

    def _get_person(self, context: Context) -> PersonFollowing | None:
        """Returns the adaptation to the person; None for a map of one person."""
        return None if self._person is None else context.get_abstract_state(self._person).get_value()

    def _observe(self, context: Context, state: State) -> EventStatus:
        """Observes the keypoints of the last update, if they passed the checks and are new."""
        person = self._get_person(context)
        memory = context.get_discrete_state(self._memory).value()[self._n :]
        p_HK = memory[:63].reshape(21, 3)
        checked = STATES[int(memory[63])] in (*FOLLOWED, HELD_OTHER_PERSON)
        if person is None or not checked or np.array_equal(person.last, p_HK):
            return EventStatus.DidNothing()
        person = person.seeing(p_HK.copy(), context.get_time())
        state.get_mutable_abstract_state(self._person).set_value(person)
        return EventStatus.Succeeded()

    def _output_result(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        discrete_state.get_mutable_vector(self._output).SetFromVector(context.get_discrete_state(0).value())
        return EventStatus.Succeeded()

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        if self._latency_is_period:
            self._output_result(context, discrete_state)
        n, period, time = self._n, self.period, context.get_time()
        # These start as copies of the present values.
        desired = discrete_state.get_mutable_value(0)
        memory = discrete_state.get_mutable_value(self._memory)
        q, v, target = desired[:n], desired[n:], memory[:n]
        code, since, excess, changed, stamp, stamped, *eased = memory[n + 63 :].tolist()
        glove, easing = GloveMemory(memory[n : n + 63], changed, stamp, stamped), Easing(*eased)
        before = STATES[int(code)]

        state, q_new, excess = self._retargeted(context, time, glove, easing, before, since, excess)
        if q_new is None:
            easing.hold(time, good=state in (SETTLING, HELD_OTHER_PERSON))
            q, v = self._limits.step(q, v, q, q, period)
            target = q
        else:
            # After a hold, a low-pass continues from the held positions; without a low-pass, nothing lags.
            last = target if easing.follows() or self._blend < 1.0 else q_new
            share = easing.follow(time, period, self._checks.ease_time)
            target = q_new if self._blend == 1.0 else last + self._blend * (q_new - last)
            q, v = self._limits.step(q, v, target, last, period, share)
            reached = q is target or np.array_equal(q, target)
            if reached or share == 1.0:
                easing.end()
            if state is None and easing.duration > 0.0:
                state = EASING
            elif state is None and excess > 0.0:
                state = OUTSIDE
            elif state is None:
                person = self._get_person(context)
                state = LIMITED if not reached else person.state if person else TRACKING

        if state != before:
            code, since = STATES.index(state), time
        memory[:n], memory[n : n + 63] = target, glove.keypoints
        memory[n + 63 :] = [
            *(code, since, excess, glove.changed, glove.stamp, glove.stamped),
            *(easing.good_since, easing.held_since, easing.eased_from, easing.duration),
        ]
        # With a velocity target, the joint's damping does not resist the commanded motion.
        desired[:n], desired[n:] = q, v
        return EventStatus.Succeeded()

    def _retargeted(
        self,
        context: Context,
        time: float,
        glove: GloveMemory,
        easing: Easing,
        before: str,
        since: float,
        excess: float,
    ) -> tuple[str | None, np.ndarray | None, float]:
        """Checks and retargets the input.

        Args:
            before, since: the state until now, and when it began, s.
            excess: result of `_excess` at the last update, m.

        Returns:
            The state, if the input determines it; the joint positions (n,), rad, or None to hold; and the new
            excess, NaN while the input is not followed.
        """
        keypoints = self._keypoints_port.Eval(context)
        valid = self._valid_port.Eval(context)[0] >= 0.5
        stamped = self._stamp_port.HasValue(context)
        stamp = float(self._stamp_port.Eval(context)[0]) if stamped else None
        fault = find_fault(self._checks, glove, time, self.period, keypoints, valid, stamp)
        frozen = fault == FROZEN and easing.follows()
        if before == FROZEN and not frozen and easing.follows():
            easing.hold(since, good=True)  # what follows frozen input is eased as after a hold
        if fault is not None and not frozen:
            return fault, None, math.nan
        if not easing.settled(time, self._checks.settle_time):
            return SETTLING, None, math.nan
        points = keypoints.reshape(21, 3)
        person = self._get_person(context)
        if person is None:
            q = np.asarray(self._retarget(points.copy()))  # a copy, because a user's function may change it
        elif person.holds(time):
            return HELD_OTHER_PERSON, None, math.nan
        else:
            q = person.retarget(points, time)
        if q.shape != self._to_plant.shape:
            raise HandError(f"the retargeter must return shape {self._to_plant.shape}; it returned {q.shape}")
        q = q.take(self._to_plant)
        excess = self._excess(points, excess, glove.moved)
        if q.dot(self._zeros) != 0.0:  # zero times NaN or infinity is NaN
            return HELD_NOT_FINITE, None, excess
        return fault, np.minimum(np.maximum(q, self._limits.lower), self._limits.upper), excess

    def _excess(self, points: np.ndarray, before: float, moved: float) -> float:
        """Returns by how much the largest distance to training exceeds the tolerance, m.

        A distance changes by no more than the fingertip moves. If motions of coordinates by up to `moved`, m,
        cannot change the sign of the last result, `before`, the result is only a bound with the same sign.
        """
        if self._trained_space is None:
            return math.nan
        least = abs(before) - _DIAGONAL * moved
        if least > _ROUNDING:
            return math.copysign(least, before)
        return float(self._trained_space.distances(points).max()) - self._checks.trained_tolerance

    def _calc_status(self, context: Context, output: AbstractValue) -> None:
        memory = context.get_discrete_state(self._memory).value()[self._n :]
        code, since, excess = memory[63:66].tolist()
        followed = None if math.isnan(excess) else memory[:63].reshape(21, 3).copy()
        person = self._get_person(context)
        unusual = person.unusual if person else ""
        output.set_value(RetargetingStatus(STATES[int(code)], since, followed, self._trained_space, unusual))
