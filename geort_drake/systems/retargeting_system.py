"""The retargeter as a system: human keypoints in, joint targets for the hand's PD controllers out."""

import dataclasses as dc
import functools
import math
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, DiscreteValues, EventStatus, LeafSystem

from geort_drake.errors import HandError
from geort_drake.retargeting.trained_space import TrainedSpace
from geort_drake.systems.easing import Easing
from geort_drake.systems.glove_checks import (
    FROZEN,
    HELD_CLOCK,
    HELD_JUMPED,
    HELD_LOST,
    HELD_NOT_FINITE,
    HELD_OUT_OF_RANGE,
    HELD_STALE,
    GloveChecks,
    GloveMemory,
    judge,
)
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.unchanging import Unchanging
from geort_drake.systems.update_timing import check_timing, low_pass_share

TRACKING = "tracking"
LIMITED = "limited: a joint is at a limit of its position, speed or acceleration"
OUTSIDE = "outside: a fingertip is far from where training saw it"
EASING = "easing: the joints catch up slowly after a hold"
SETTLING = "held: the input has not been good for long enough"
STATES = (
    TRACKING,
    LIMITED,
    OUTSIDE,
    EASING,
    SETTLING,
    HELD_LOST,
    HELD_NOT_FINITE,
    HELD_OUT_OF_RANGE,
    HELD_STALE,
    HELD_CLOCK,
    HELD_JUMPED,
    FROZEN,
)
# A point moves at most so many times as far as any of its coordinates.
_DIAGONAL = math.sqrt(3.0)
_ROUNDING = 1e-9  # m; of distances


@dc.dataclass(frozen=True)
class RetargetingStatus(Unchanging):
    """What the system does with its input, and since which time (s)."""

    state: str = SETTLING
    since: float = 0.0
    # What `distance` is measured from: (21, 3) m in H, None while the input is not followed.
    p_HK: np.ndarray | None = dc.field(default=None, repr=False, compare=False)
    trained_space: TrainedSpace | None = dc.field(default=None, repr=False, compare=False)

    @functools.cached_property
    def distance(self) -> float:
        """How far a fingertip is from all places it had in training, the farthest one's, m.

        NaN where that is not known, and while the input is not followed. Measured when it is first asked for,
        because that takes longer than the rest of a status.
        """
        if self.p_HK is None or self.trained_space is None:
            return math.nan
        return self.trained_space.distances(self.p_HK).max().item()


class RetargetingSystem(LeafSystem):
    """Retargets at a fixed period; its targets are finite and keep the limits, whatever comes in.

    Input that cannot be followed is answered by braking to a stop and holding; when it is good again, the
    hand follows with growing speed (docs/safety.md). A retargeter takes its time: what it makes of the
    keypoints comes out `latency` later. One that takes longer than the period is called again as soon as
    it is done, with the keypoints of that moment.

    Input ports:
        keypoints (63): p_HK, the 21 keypoints one after the other, m, wrist frame H.
        valid (1): 1 tracked, 0 lost.
        stamp (1), need not be connected: when the keypoints were measured, s, on the glove's clock.
    Output ports:
        desired_state (2n): joint positions (rad), then velocities (rad/s), in the order of
            `actuated_joints`, which is the plant's actuator order of the hand.
        status (abstract RetargetingStatus): what was held or limited, and since when.

    Attributes:
        period: time between updates, s.
        delay: from the keypoints to what is made of them, s: `latency`, and that of the low-pass for slow
            motion.

    State: the 2n desired values last computed; what is remembered of status and input; and with a latency
    the 2n desired values last given out (discrete, so there is no direct feedthrough).

    Args:
        retarget: maps keypoints (21, 3) in H to joint positions (n,) in `joint_names` order.
        joint_names: the retargeter's joints.
        actuated_joints: the plant's actuated joints of the hand, in actuator order; each must be one
            of `joint_names`.
        initial_positions: joint name → rad, the targets before the first update.
        period: time between updates, s, from 1e-5 to 10; no less than `latency` in effect.
        limits: of the targets, in the order of `actuated_joints`. None takes the positions of the
            retargeter's `lower` and `upper`, and the defaults of `JointLimits`.
        latency: time from the keypoints to their joint targets, s, at most 10.
        checks: which input is followed.
        cutoff: of a first-order low-pass on the targets, Hz; 0 is without. `delay` tells what it costs.
        trained_space: where training saw the fingertips. None takes the retargeter's `trained_space`;
            where it has none either, nothing is reported about it.

    Raises:
        HandError: the plant's joints and the retargeter's are not the same set, there are no joint
            limits, or an initial position is outside them.
        ValueError: a value of `checks`, or the period, latency or cutoff cannot work.
    """

    def __init__(
        self,
        retarget: Callable[[np.ndarray], np.ndarray],
        joint_names: Sequence[str],
        actuated_joints: Sequence[str],
        initial_positions: dict[str, float],
        period: float = 0.01,
        limits: JointLimits | None = None,
        latency: float = 0.0,
        checks: GloveChecks | None = None,
        cutoff: float = 0.0,
        trained_space: TrainedSpace | None = None,
    ):
        super().__init__()
        if set(joint_names) != set(actuated_joints):
            raise HandError(
                "the retargeter and the plant move different joints: the retargeter has "
                f"{', '.join(sorted(joint_names))}; the plant's hand has {', '.join(sorted(actuated_joints))}"
            )
        self._checks = checks or GloveChecks()
        self._checks.validate()
        check_timing(period, latency, cutoff)
        self._retarget = retarget
        self._to_plant = np.array([list(joint_names).index(name) for name in actuated_joints])
        self._trained_space = trained_space or getattr(retarget, "trained_space", None)
        self._limits = limits or self._limits_of(retarget)
        self.period = period = max(period, latency)
        self._blend = low_pass_share(cutoff, period)
        self.delay = latency + period * (1.0 - self._blend) / self._blend
        self._n = n = len(actuated_joints)
        self._zeros = np.zeros(n)
        self._keypoints_port = self.DeclareVectorInputPort("keypoints", 63)
        self._valid_port = self.DeclareVectorInputPort("valid", 1)
        self._stamp_port = self.DeclareVectorInputPort("stamp", 1)
        q0 = np.array([initial_positions[name] for name in actuated_joints])
        for name, q, low, high in zip(
            actuated_joints, q0, self._limits.lower, self._limits.upper, strict=True
        ):
            if not low <= q <= high:
                raise HandError(
                    f"the initial position of '{name}' must be within [{low:g}, {high:g}] rad; given: {q:g}"
                )
        desired = self.DeclareDiscreteState(np.concatenate([q0, np.zeros(n)]))
        easing = Easing.at_start(self._checks.ease_at_start)
        numbers = [STATES.index(SETTLING), 0.0, math.nan, 0.0, math.nan, 0.0, *dc.astuple(easing)]
        self._memory = self.DeclareDiscreteState(np.concatenate([q0, np.full(63, math.nan), numbers]))
        # With a latency, what is given out is kept apart from what is computed meanwhile.
        self._given_out = desired
        if latency > 0:
            self._given_out = self.DeclareDiscreteState(np.concatenate([q0, np.zeros(n)]))
        self.DeclareStateOutputPort("desired_state", self._given_out)
        self.DeclareAbstractOutputPort(
            "status",
            lambda: AbstractValue.Make(RetargetingStatus()),
            self._calc_status,
            {self.discrete_state_ticket(self._memory)},
        )
        # Two events due at once would be at the mercy of rounding, so one that is busy all the time gives
        # out its last result when it takes up the next.
        self._busy = latency > period - 1e-9
        if latency > 0 and not self._busy:
            self.DeclarePeriodicDiscreteUpdateEvent(period, latency, self._give_out)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _limits_of(self, retarget: Callable) -> JointLimits:
        lower, upper = getattr(retarget, "lower", None), getattr(retarget, "upper", None)
        if lower is None or upper is None:
            raise HandError("the joint limits are not known: give `limits`, as the retargeter has none")
        return JointLimits(lower[self._to_plant], upper[self._to_plant])

    def _give_out(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        discrete_state.get_mutable_vector(self._given_out).SetFromVector(
            context.get_discrete_state(0).value()
        )
        return EventStatus.Succeeded()

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        if self._busy:
            self._give_out(context, discrete_state)
        n, period, time = self._n, self.period, context.get_time()
        # What is to be written begins as what is there.
        desired = discrete_state.get_mutable_value(0)
        memory = discrete_state.get_mutable_value(self._memory)
        q, v, target = desired[:n], desired[n:], memory[:n]
        code, since, excess, *numbers = memory[n + 63 :].tolist()
        glove, easing = GloveMemory(memory[n : n + 63], *numbers[:3]), Easing(*numbers[3:])
        before = STATES[int(code)]

        state, wanted, excess = self._wanted(context, time, glove, easing, before, since, excess)
        if wanted is None:
            easing.hold(time, good=state == SETTLING)
            q, v = self._limits.step(q, v, q, q, period)
            target = q
        else:
            # The low-pass goes on from where the hand was held; without one, nothing lags behind.
            last = target if easing.follows() or self._blend < 1.0 else wanted
            share = easing.follow(time, period, self._checks.ease_time)
            target = wanted if self._blend == 1.0 else last + self._blend * (wanted - last)
            q, v = self._limits.step(q, v, target, last, period, share)
            reached = q is target or np.array_equal(q, target)
            if reached or share == 1.0:
                easing.end()
            if state is None:
                state = self._following(easing, excess, reached)

        if state != before:
            code, since = STATES.index(state), time
        memory[:n], memory[n : n + 63] = target, glove.keypoints
        memory[n + 63 :] = [
            *(code, since, excess, glove.changed, glove.stamp, glove.stamped),
            *(easing.good_since, easing.held_since, easing.eased_from, easing.duration),
        ]
        # The velocity target keeps the joint's damping from acting against a wanted motion.
        desired[:n], desired[n:] = q, v
        return EventStatus.Succeeded()

    def _wanted(
        self,
        context: Context,
        time: float,
        glove: GloveMemory,
        easing: Easing,
        before: str,
        since: float,
        excess: float,
    ) -> tuple[str | None, np.ndarray | None, float]:
        """The state that the input decides, if any; what it asks of the joints (n,) rad, None to hold them;
        and the fingertips' `_excess`, NaN where nothing is asked.

        `before` is the state until now, `since` when it began, `excess` that of the last update.
        """
        keypoints = self._keypoints_port.Eval(context)
        valid = self._valid_port.Eval(context)[0] >= 0.5
        stamped = self._stamp_port.HasValue(context)
        stamp = float(self._stamp_port.Eval(context)[0]) if stamped else None
        fault = judge(self._checks, glove, time, self.period, keypoints, valid, stamp)
        frozen = fault == FROZEN and easing.follows()
        if before == FROZEN and not frozen and easing.follows():
            easing.hold(since, good=True)  # what comes after frozen input is eased as after a hold
        if fault is not None and not frozen:
            return fault, None, math.nan
        if not easing.settled(time, self._checks.settle_time):
            return SETTLING, None, math.nan
        points = keypoints.reshape(21, 3)
        wanted = self._retarget(points).take(self._to_plant)
        excess = self._excess(points, excess, glove.moved)
        if wanted.dot(self._zeros) != 0.0:  # a zero times NaN or infinity is NaN
            return HELD_NOT_FINITE, None, excess
        wanted = np.minimum(np.maximum(wanted, self._limits.lower), self._limits.upper)
        return fault, wanted, excess

    def _excess(self, points: np.ndarray, before: float, moved: float) -> float:
        """How much farther from training a fingertip is than tolerated, m: right in sign, at most in size.

        A distance changes by no more than the fingertip moves. So it is measured only where coordinates that
        `moved` by so much may have changed the sign since `before`, which this returned at the last update.
        """
        if self._trained_space is None:
            return math.nan
        left = abs(before) - _DIAGONAL * moved
        if left > _ROUNDING:
            return math.copysign(left, before)
        return float(self._trained_space.distances(points).max()) - self._checks.trained_tolerance

    def _following(self, easing: Easing, excess: float, reached: bool) -> str:
        """The state of a hand that follows good input."""
        if easing.duration > 0.0:
            return EASING
        if excess > 0.0:
            return OUTSIDE
        return TRACKING if reached else LIMITED

    def _calc_status(self, context: Context, output: AbstractValue) -> None:
        memory = context.get_discrete_state(self._memory).value()[self._n :]
        code, since, excess = memory[63:66].tolist()
        followed = None if math.isnan(excess) else memory[:63].reshape(21, 3).copy()
        output.set_value(RetargetingStatus(STATES[int(code)], since, followed, self._trained_space))
