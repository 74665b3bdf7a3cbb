"""Runs a retargeter as a system, from human keypoints to targets of joint controllers."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Context, DiscreteValues, EventStatus

from geort_drake.errors import FrameError, GeortError, HandError
from geort_drake.hands.description import HandDescription, load_hand
from geort_drake.people.keypoints import KEYPOINT_COUNT
from geort_drake.resources import hand_names
from geort_drake.systems.joint_limits import DEFAULT_SPEED, JointLimits, actuated_joints, check_timing
from geort_drake.systems.person import PERSON_FIELDS, PersonMap
from geort_drake.systems.python_system import PythonSystem
from geort_drake.systems.retargeting_status import (
    EASING,
    FOLLOWED,
    FROZEN,
    GLOVE_FIELDS,
    HELD_NOT_FINITE,
    HELD_OTHER_PERSON,
    HELD_OUT_OF_RANGE,
    LIMITED,
    MEASURING,
    OUTSIDE,
    SETTLING,
    STATES,
    TRACKING,
    RetargetingStatus,
    find_fault,
)

_ROUNDING = 1e-9  # s; of sums of periods
_SAME_LIMITS = 0.05  # rad; files of one hand round its limits differently
_DISTANCE_PERIOD = 0.1  # s, between two computations of the distance from training
# m; a fingertip farther than this from its training data is reported. New motions of the same person stay
# within 0.01 m; another person's hand is 0.03 to 0.05 m away.
_TRAINED_TOLERANCE = 0.02
_SETTLE_TIME = 0.03  # s; the input must be good for this long before it is followed
# s; after a hold, the joints' speed limit grows from zero over the hold's duration, at most this.
_EASE_TIME = 0.5


class RetargetingSystem(PythonSystem):
    """Maps keypoints to joint targets at a fixed period; the output respects the limits for any input.

    An update has three stages. The gate decides whether the keypoints can be followed. The map is one fixed
    function of the keypoints, unless the method itself has a memory; that of a universal retargeter is for
    the person who is measured in the first `MEASURED_FRAMES` good frames, and holds when it sees another
    person's bone lengths. The limiter moves towards the map's joint positions within the limits. While the
    input cannot be followed, it brakes and holds the joints; afterwards they follow again at a growing speed
    limit.

    Joint targets appear `latency` after their keypoints. A retargeter that takes longer than the period is
    called again as soon as it is done, with the latest keypoints.

    Input ports:
        keypoints (63): p_HK, keypoint-major, m, wrist frame H.
        valid (1), optional: 1 tracked, 0 lost; tracked where it is not connected.
        stamp (1), optional: time of measurement of the keypoints, s, on the glove's clock.
    Output ports:
        desired_state (2n): joint positions (rad), then velocities (rad/s), in the model's actuator order.
        status (abstract RetargetingStatus): what was held or limited, and since when.

    There is no direct feedthrough. The status `OUTSIDE` needs a retargeter with `trained_points`.

    Attributes:
        joint_names: the model's actuated joints, in the order of the output.
        period: time between updates, s.
        delay: from keypoints to their joint targets, s: the latency plus the low-pass filter's delay of slow
            motion.

    State: the last computed desired state (2n); a record of the gate and the limiter (`_memory_fields`); for
    a universal retargeter, a record of the person (`PERSON_FIELDS`); and, with a latency, the desired state
    (2n) of the output port.

    Args:
        retarget: a function from keypoints (21, 3), m in H, to joint positions (n,), rad, with the attribute
            `joint_names`; or a `UniversalRetargeter`. If it raises an exception, the simulation ends.
        plant: finalized plant with the robot hand; the system reads joints and limits, and does not keep it.
        model: the hand in `plant`.
        joint_names: the joints of the function's result, in its order; by default `retarget.joint_names`.
        initial_positions: joint name → rad, the targets before the first update; by default the model's
            default positions.
        period: time between updates, s, from 1e-5 to 10; raised to `latency` if that is longer.
        limits: limits of the targets, in actuator order; by default those of the model, with a speed of at
            most 7 rad/s. Without them, a retargeter that knows its hand's limits must have the model's, as
            hands of different makes have joints of the same names.
        latency: time from keypoints to their joint targets, s, at most 10.
        ease_at_start: whether the start counts as the end of a long hold; otherwise the first keypoints are
            followed at once.
        cutoff: cutoff frequency of a first-order low-pass on the targets, Hz; 0 for none.

    Raises:
        HandError: the retargeter's joints are unknown or are not those that the model actuates, or have other
            limits; a shipped map is for the hand of the other side; or an initial position is outside of the
            limits; while it runs, `retarget` returned another shape.
        ValueError: the period, latency or cutoff is out of range.
    """

    def __init__(
        self,
        retarget: Callable[[np.ndarray], np.ndarray],
        plant: MultibodyPlant,
        model: ModelInstanceIndex,
        *,
        joint_names: Sequence[str] | None = None,
        initial_positions: Mapping[str, float] | None = None,
        period: float = 0.01,
        limits: JointLimits | None = None,
        latency: float = 0.0,
        ease_at_start: bool = True,
        cutoff: float = 0.0,
    ):
        super().__init__()
        joints = actuated_joints(plant, model)
        self.joint_names = [joint.name() for joint in joints]
        order = getattr(retarget, "joint_names", ()) if joint_names is None else joint_names
        if not order:
            raise HandError("the joints of the retargeter's result are unknown: give `joint_names`")
        if sorted(order) != sorted(self.joint_names):
            raise HandError(
                "the retargeter and the model move different joints: the retargeter has "
                f"{', '.join(sorted(order))}; the model has {', '.join(sorted(self.joint_names))}"
            )
        self._to_plant = np.array([list(order).index(name) for name in self.joint_names])
        self._retarget = retarget
        self._distances = getattr(retarget, "distances", None)
        for_person = getattr(retarget, "for_person", None)
        self._person_map = None if for_person is None else PersonMap(for_person)
        self._limits = limits or JointLimits.of_plant(plant, model, DEFAULT_SPEED)
        if limits is None:
            self._check_ranges(retarget)
        _check_side(retarget, plant, model)
        if initial_positions is None:
            initial_positions = {joint.name(): float(joint.default_positions()[0]) for joint in joints}
        q0 = self._limits.start(initial_positions, self.joint_names)
        check_timing(period, latency, cutoff)
        self.period = period = max(period, latency)
        # Fraction of the way to its input that the low-pass moves in a period.
        self._blend = -math.expm1(-2.0 * math.pi * cutoff * period) if cutoff > 0 else 1.0
        self.delay = latency + period * (1.0 - self._blend) / self._blend

        self._keypoints_port = self.DeclareVectorInputPort("keypoints", 3 * KEYPOINT_COUNT)
        self._valid_port = self.DeclareVectorInputPort("valid", 1)
        self._stamp_port = self.DeclareVectorInputPort("stamp", 1)
        n = len(joints)
        self._desired = self.DeclareDiscreteState(np.concatenate([q0, np.zeros(n)]))
        self._memory_fields = np.dtype(
            [
                *GLOVE_FIELDS,
                ("good_since", float),  # when the input became good, s; NaN while it is bad
                ("target", float, n),  # the low-passed result of the map, rad
                ("held_since", float),  # when the hold began, s; NaN while the hand follows
                ("eased_from", float),  # when the last easing began, s
                ("easing", float),  # duration of the easing, s; 0 if none is active
                ("state", float),  # index in `STATES`
                ("since", float),  # when this state began, s
                ("distance", float),  # of the fingertips from training, m; NaN if unknown
                ("distance_at", float),  # when it was computed, s
            ]
        )
        start = np.full(1, math.nan, self._memory_fields)
        start["target"] = q0
        for name in ("changed", "stamped", "eased_from", "easing", "since"):
            start[name] = 0.0
        start["state"], start["distance_at"] = STATES.index(SETTLING), -math.inf
        # The start is the end of a long hold, or the hand follows at once.
        start["held_since" if ease_at_start else "good_since"] = -math.inf
        self._memory = self.DeclareDiscreteState(start.view(float))
        if self._person_map is not None:
            self._person = self.DeclareDiscreteState(np.zeros(1, PERSON_FIELDS).view(float))
        # With a latency, the output port has its own state.
        self._output = self._desired
        if latency > 0:
            self._output = self.DeclareDiscreteState(np.concatenate([q0, np.zeros(n)]))
        self.DeclareStateOutputPort("desired_state", self._output)
        self.DeclareAbstractOutputPort(
            "status",
            lambda: AbstractValue.Make(RetargetingStatus()),
            self._calc_status,
            {self.discrete_state_ticket(self._memory)},
        )
        # The order of two simultaneous events would depend on rounding, so with a latency of one period the
        # update itself outputs the last result.
        self._latency_is_period = latency > period - 1e-9
        if latency > 0 and not self._latency_is_period:
            self.DeclarePeriodicDiscreteUpdateEvent(period, latency, self._output_result)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def measure_person(self, context: Context) -> None:
        """Forgets the measured person, so that the hand in the next good frames is measured.

        Does nothing for a map of one person.

        Raises:
            GeortError: the hand is being followed; disengage it first, by the input `valid`.
        """
        if self._person_map is None:
            return
        memory = context.get_discrete_state(self._memory).value().view(self._memory_fields)[0]
        if STATES[int(memory["state"])] in (*FOLLOWED, FROZEN):
            raise GeortError("the map of a hand that is being followed cannot change: disengage it first")
        person = context.get_mutable_discrete_state(self._person).get_mutable_value()
        person.view(PERSON_FIELDS)[0]["count"] = 0

    def _check_ranges(self, retarget: Any) -> None:
        """Raises HandError if the retargeter's joints have other limits than the model's.

        A joint that others follow may have narrower ones, within which these keep to their own limits.
        """
        lower, upper = getattr(retarget, "lower", None), getattr(retarget, "upper", None)
        if lower is None or upper is None:
            return
        expected = np.stack([lower, upper], axis=1)[self._to_plant]
        limits = np.stack([self._limits.lower, self._limits.upper], axis=1)
        differences = np.abs(expected - limits).max(axis=1)
        leaders = {c.follows for hand in _known_hands(retarget) for c in hand.followers}
        beyond = np.maximum(limits[:, 0] - expected[:, 0], expected[:, 1] - limits[:, 1])
        differences = np.where(np.isin(self.joint_names, sorted(leaders)), beyond, differences)
        if differences.max() > _SAME_LIMITS:
            worst = int(differences.argmax())
            (low, high), (model_low, model_high) = expected[worst], limits[worst]
            hands = ", ".join(getattr(retarget, "robot_hands", ())) or "its hand"
            raise HandError(
                f"joint '{self.joint_names[worst]}' moves from {low:.3f} to {high:.3f} rad in the retargeter "
                f"for {hands}, and from {model_low:.3f} to {model_high:.3f} rad in the plant. If it is "
                "the same hand, give `limits`"
            )

    def _output_result(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        desired = context.get_discrete_state(self._desired).value()
        discrete_state.get_mutable_vector(self._output).SetFromVector(desired)
        return EventStatus.Succeeded()

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        if self._latency_is_period:
            self._output_result(context, discrete_state)
        # These start as copies of the present values.
        desired = discrete_state.get_mutable_value(self._desired)
        memory = discrete_state.get_mutable_value(self._memory).view(self._memory_fields)[0]
        now = context.get_time()
        p_HK = self._keypoints_port.Eval(context)
        state, followed = self._gate(context, memory, p_HK, now)
        q = None
        if followed:
            held, q = self._map(discrete_state, memory, p_HK.reshape(KEYPOINT_COUNT, 3), now)
            state = held or state
        state = self._limit(desired, memory, q, state, now)
        if state != STATES[int(memory["state"])]:
            memory["state"], memory["since"] = STATES.index(state), now
        return EventStatus.Succeeded()

    def _gate(
        self, context: Context, memory: np.void, p_HK: np.ndarray, now: float
    ) -> tuple[str | None, bool]:
        """Returns the state, if the input p_HK (63,), m, determines it, and whether it is followed."""
        valid = not self._valid_port.HasValue(context) or self._valid_port.Eval(context)[0] >= 0.5
        stamp = float(self._stamp_port.Eval(context)[0]) if self._stamp_port.HasValue(context) else None
        fault = find_fault(memory, now, self.period, p_HK, valid, stamp)
        follows = math.isnan(memory["held_since"])
        frozen = fault == FROZEN and follows
        if follows and not frozen and STATES[int(memory["state"])] == FROZEN:
            memory["held_since"] = memory["since"]  # what follows frozen input is eased as after a hold
        if fault is not None and not frozen:
            memory["good_since"] = math.nan
            return fault, False
        if math.isnan(memory["good_since"]):
            memory["good_since"] = now
        if now - memory["good_since"] < _SETTLE_TIME - _ROUNDING:
            return SETTLING, False
        return fault, True

    def _map(
        self, discrete_state: DiscreteValues, memory: np.void, p_HK: np.ndarray, now: float
    ) -> tuple[str | None, np.ndarray | None]:
        """Maps keypoints (21, 3), m.

        Returns:
            The state, if it is a hold, and the joint positions (n,) in actuator order, rad, or None to hold.
        """
        try:
            if self._person_map is None:
                q = self._retarget(p_HK.copy())  # a copy, because a user's function may change it
            else:
                person = discrete_state.get_mutable_value(self._person).view(PERSON_FIELDS)[0]
                if not self._person_map.measure(person, p_HK):
                    return MEASURING, None
                if self._person_map.is_other_person(person, p_HK, now):
                    return HELD_OTHER_PERSON, None
                q = self._person_map(person, p_HK)
        except FrameError:  # a bad frame, as of a camera that took the other hand for this one
            memory["good_since"] = math.nan
            return HELD_OUT_OF_RANGE, None
        q = np.asarray(q)
        if q.shape != self._to_plant.shape:
            raise HandError(f"the retargeter must return shape {self._to_plant.shape}; it returned {q.shape}")
        if not np.isfinite(q).all():
            memory["good_since"] = math.nan
            return HELD_NOT_FINITE, None
        if self._distances is not None and now - memory["distance_at"] >= _DISTANCE_PERIOD - _ROUNDING:
            memory["distance"], memory["distance_at"] = self._distances(p_HK).max(), now
        return None, np.clip(q[self._to_plant], self._limits.lower, self._limits.upper)

    def _limit(
        self, desired: np.ndarray, memory: np.void, q: np.ndarray | None, state: str | None, now: float
    ) -> str:
        """Moves `desired` (2n,) towards joint positions q (n,), rad, or brakes and holds; returns the state.

        Args:
            state: as determined by gate and map.
        """
        positions, velocities = np.split(desired, 2)
        if q is None:
            if math.isnan(memory["held_since"]):
                memory["held_since"] = now
            memory["distance"], memory["distance_at"] = math.nan, -math.inf
            stepped = self._limits.step(positions, velocities, positions, positions, self.period)
            positions[:], velocities[:] = stepped
            memory["target"] = positions
            return state or SETTLING
        # After a hold, a low-pass continues from the held positions; without a low-pass, nothing lags.
        follows = math.isnan(memory["held_since"])
        last = memory["target"].copy() if follows or self._blend < 1.0 else q
        if not follows:
            memory["easing"] = min(_EASE_TIME, now - memory["held_since"])
            memory["eased_from"], memory["held_since"] = now, math.nan
        share = 1.0  # usable fraction of the speed limit
        if memory["easing"] > 0.0:
            share = min((now - memory["eased_from"] + self.period) / memory["easing"], 1.0)
        memory["target"] = target = q if self._blend == 1.0 else last + self._blend * (q - last)
        # With a velocity target, the joint's damping does not resist the commanded motion.
        stepped = self._limits.step(positions, velocities, target, last, self.period, share)
        positions[:], velocities[:] = stepped
        reached = np.array_equal(positions, target)
        if reached or share == 1.0:
            memory["easing"] = 0.0
        if state is not None:
            return state
        if memory["easing"] > 0.0:
            return EASING
        if memory["distance"] > _TRAINED_TOLERANCE:
            return OUTSIDE
        return TRACKING if reached else LIMITED

    def _calc_status(self, context: Context, output: AbstractValue) -> None:
        memory = context.get_discrete_state(self._memory).value().view(self._memory_fields)[0]
        state, since, distance = (memory[name].item() for name in ("state", "since", "distance"))
        output.set_value(RetargetingStatus(STATES[int(state)], since, distance))


def _known_hands(retarget: Any) -> list[HandDescription]:
    """Returns the hands known by name for which a map was made."""
    names = set(getattr(retarget, "robot_hands", ())).intersection(hand_names())
    return [load_hand(name) for name in sorted(names)]


def _check_side(retarget: Any, plant: MultibodyPlant, model: ModelInstanceIndex) -> None:
    """Raises HandError if the map of a hand known by name is given the hand of the other side.

    Both may have joints of the same names and limits, as Allegro's have. The thumb tells them apart: with all
    joints at zero, it is on the side of the index finger, +y of the hand base for a right hand. Plants that
    lack the description's frames are not checked.
    """
    for hand in _known_hands(retarget):
        links = {finger.name: finger.tip_link for finger in hand.fingers}
        if not all(plant.HasFrameNamed(frame, model) for frame in (hand.base_frame, *links.values())):
            continue
        context, base = plant.CreateDefaultContext(), plant.GetFrameByName(hand.base_frame, model)
        q = plant.GetPositions(context)
        for joint in map(plant.get_joint, plant.GetJointIndices(model)):
            if joint.num_positions() == 1:
                q[joint.position_start()] = 0.0
        plant.SetPositions(context, q)
        y = {
            finger: plant.GetFrameByName(link, model).CalcPose(context, base).translation()[1]
            for finger, link in links.items()
        }
        towards_index = y.pop("thumb", math.nan) - np.mean([*y.values()])
        if (towards_index if hand.side == "right" else -towards_index) < 0:
            raise HandError(f"the retargeter is for {hand.name}, but the plant has a hand of the other side")
