"""Judges a grasp from the physics alone: lifted and held, or failed, and in which phase."""

import dataclasses as dc
import enum
import math
from collections.abc import Callable

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiscreteValues, EventStatus, LeafSystem

from geort_drake.systems.port_values import vector_to_pose


class GraspPhase(enum.IntEnum):
    """How far the grasp has come."""

    REACH = 0  # nothing touches the object
    TOUCH = 1  # one finger touches
    GRASP = 2  # two or more fingers touch
    LIFT = 3  # and the object has left its support
    HOLD = 4  # and it is high enough
    DONE = 5  # and it stayed there long enough
    THROWN = 6  # it lies beside its support, out of reach


@dc.dataclass
class GraspMonitorConfig:
    """What counts as a grasp."""

    # Time between two looks, s.
    period: float = 0.01
    # The object's lowest point must be this high above its support, m, for this long, s.
    height: float = 0.10
    hold_time: float = 2.0
    # The object has left its support above this height, m.
    lifted: float = 0.005
    # An object that is this far below its support, or this far from its start and not in the hand, was
    # thrown, m.
    fallen: float = 0.03
    strayed: float = 0.30
    # A contact force above this is a touch, N.
    touch_force: float = 0.02
    # A lifted object was dropped when fewer than two fingers have touched it for this long, s.
    drop_time: float = 0.1

    def validate(self) -> None:
        """Raises ValueError for values that cannot work."""
        for field in dc.fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"monitor.{field.name} must be positive and finite, not {value}")


@dc.dataclass(frozen=True)
class GraspOutcome:
    """What has come of the grasp so far; times in s since the start, NaN where it has not happened."""

    phase: GraspPhase = GraspPhase.REACH
    # First entry of each phase, by its name, and the time spent in it altogether.
    times: dict[str, float] = dc.field(default_factory=dict)
    durations: dict[str, float] = dc.field(default_factory=dict)
    # The present time above the height began here; NaN while lower.
    held_since: float = float("nan")
    # The last phase in which a finger touched the object, REACH where none has; the phases that end the
    # trial do not count.
    last_touched: GraspPhase = GraspPhase.REACH
    # How often a lift ended: the object was back on its support, or two fingers had left it for `drop_time`.
    drops: int = 0
    # Furthest way of the object's origin in the hand base's frame since the last lift began, m, while two
    # fingers touched it; NaN where nothing was lifted. A lift begins with LIFT and ends with a drop.
    slip: float = float("nan")
    peak_force: float = 0.0
    peak_height: float = 0.0
    # Time for which links of the hand touched each other, s; see `SceneView`.
    self_contact_time: float = 0.0

    @property
    def success(self) -> bool:
        """Whether the object was held high enough for long enough."""
        return self.phase == GraspPhase.DONE

    @property
    def over(self) -> bool:
        """Whether nothing more can come of the trial."""
        return self.phase in _OVER

    @property
    def completion_time(self) -> float:
        """Start to the beginning of the successful hold, s; NaN without success."""
        return self.held_since if self.success else float("nan")


# What the numbers of the monitor's state are.
_PHASE, _HELD_SINCE, _LAST_TOUCHED, _DROPS, _SLIP, _PEAK_FORCE, _PEAK_HEIGHT, _SELF_CONTACT_TIME = range(8)
_LOOSE_SINCE = 8  # the present time with fewer than two fingers, in a lift; NaN otherwise
_TIMES = slice(9, 9 + len(GraspPhase))  # by phase; NaN before the first entry
_DURATIONS = slice(_TIMES.stop, _TIMES.stop + len(GraspPhase))
_START = slice(_DURATIONS.stop, _DURATIONS.stop + 3)  # p_WO at the first look; NaN before
_LIFTED_AT = slice(_START.stop, _START.stop + 3)  # p_BO when the present lift began; NaN outside of one
_STATE_SIZE = _LIFTED_AT.stop
_LIFTED = (GraspPhase.LIFT, GraspPhase.HOLD, GraspPhase.DONE)
_OVER = (GraspPhase.DONE, GraspPhase.THROWN)


class GraspMonitor(LeafSystem):
    """Watches object and contacts, without delay or noise, and ends the simulation when the grasp is judged.

    Input ports (F fingers):
        object_pose (7): X_WO, qw qx qy qz x y z.
        hand_pose (7): X_WB of the robot's hand base.
        contact (F): force between each finger and the object, N.
        self_contact (1): above 0 while links of the hand touch each other.
    Output ports:
        phase (1): `GraspPhase` as a number.
        outcome (abstract GraspOutcome).

    State: the outcome as numbers (discrete), which Drake copies faster than a Python object.

    Args:
        lowest_point: height in W of the object's lowest point when the object is at X_WO, m.
        support_height: height of the support in W, m.
    """

    def __init__(
        self,
        num_fingers: int,
        lowest_point: Callable[[RigidTransform], float],
        support_height: float,
        config: GraspMonitorConfig,
    ):
        super().__init__()
        config.validate()
        self._lowest_point = lowest_point
        self._support = support_height
        self._config = config
        self._object_pose = self.DeclareVectorInputPort("object_pose", 7)
        self._hand_pose = self.DeclareVectorInputPort("hand_pose", 7)
        self._contact = self.DeclareVectorInputPort("contact", num_fingers)
        self._self_contact = self.DeclareVectorInputPort("self_contact", 1)
        start = np.full(_STATE_SIZE, math.nan)
        start[[_PHASE, _LAST_TOUCHED, _DROPS, _PEAK_FORCE, _PEAK_HEIGHT, _SELF_CONTACT_TIME]] = 0.0
        start[_DURATIONS] = 0.0
        ticket = {self.discrete_state_ticket(self.DeclareDiscreteState(start))}
        self.DeclareVectorOutputPort(
            "phase", 1, lambda context, output: output.SetAtIndex(0, self._numbers(context)[_PHASE]), ticket
        )
        self.DeclareAbstractOutputPort(
            "outcome",
            lambda: AbstractValue.Make(GraspOutcome()),
            lambda context, output: output.set_value(self.outcome(context)),
            ticket,
        )
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._look)

    def outcome(self, context: Context) -> GraspOutcome:
        """The outcome so far."""
        numbers = self._numbers(context).tolist()
        times = {p.name: t for p, t in zip(GraspPhase, numbers[_TIMES], strict=True) if not math.isnan(t)}
        return GraspOutcome(
            phase=GraspPhase(int(numbers[_PHASE])),
            times=dict(sorted(times.items(), key=lambda entry: entry[1])),
            durations={
                p.name: spent for p, spent in zip(GraspPhase, numbers[_DURATIONS], strict=True) if spent
            },
            held_since=numbers[_HELD_SINCE],
            last_touched=GraspPhase(int(numbers[_LAST_TOUCHED])),
            drops=int(numbers[_DROPS]),
            slip=numbers[_SLIP],
            peak_force=numbers[_PEAK_FORCE],
            peak_height=numbers[_PEAK_HEIGHT],
            self_contact_time=numbers[_SELF_CONTACT_TIME],
        )

    def _numbers(self, context: Context) -> np.ndarray:
        return context.get_discrete_state(0).value()

    def _look(self, context: Context, state: DiscreteValues) -> EventStatus:
        # What is to be written begins as what is there.
        numbers = state.get_mutable_value(0)
        before = GraspPhase(int(numbers[_PHASE]))
        if before in _OVER:
            return EventStatus.DidNothing()
        config, t = self._config, context.get_time()
        pose = self._object_pose.Eval(context)
        force = self._contact.Eval(context).tolist()
        if math.isnan(numbers[_START.start]):
            numbers[_START] = pose[4:]
        x, y = numbers[_START].tolist()[:2]
        height = self._lowest_point(vector_to_pose(pose)) - self._support
        touching = sum(one > config.touch_force for one in force)
        strayed = math.hypot(pose[4] - x, pose[5] - y) > config.strayed
        held_since = math.nan
        if height >= config.height and touching >= 2:
            held_since = t if math.isnan(numbers[_HELD_SINCE]) else float(numbers[_HELD_SINCE])
            phase = GraspPhase.DONE if t - held_since >= config.hold_time else GraspPhase.HOLD
        elif height < -config.fallen or (strayed and touching == 0):
            phase = GraspPhase.THROWN
        elif height > config.lifted and touching >= 2:
            phase = GraspPhase.LIFT
        else:
            phase = GraspPhase(min(touching, 2))
        if touching and phase not in _OVER:
            numbers[_LAST_TOUCHED] = phase
        if phase in _LIFTED:
            self._follow_lift(numbers, vector_to_pose(self._hand_pose.Eval(context)).inverse() @ pose[4:])
        elif not math.isnan(numbers[_LIFTED_AT.start]):
            self._look_for_drop(numbers, t, touching, on_support=height <= config.lifted)
        if math.isnan(numbers[_TIMES][phase]):
            numbers[_TIMES][phase] = t
        if t > 0:
            numbers[_DURATIONS][before] += config.period
            numbers[_SELF_CONTACT_TIME] += config.period * (self._self_contact.Eval(context)[0] > 0)
        numbers[_PHASE], numbers[_HELD_SINCE] = phase, held_since
        numbers[_PEAK_FORCE] = max(numbers[_PEAK_FORCE], *force)
        numbers[_PEAK_HEIGHT] = max(numbers[_PEAK_HEIGHT], height)
        if phase in _OVER:
            return EventStatus.ReachedTermination(self, "the grasp is judged")
        return EventStatus.Succeeded()

    def _follow_lift(self, numbers: np.ndarray, p_BO: np.ndarray) -> None:
        """Begins a lift, or goes on with it, while two fingers hold the object at p_BO (3,), m."""
        numbers[_LOOSE_SINCE] = math.nan
        if math.isnan(numbers[_LIFTED_AT.start]):
            numbers[_LIFTED_AT], numbers[_SLIP] = p_BO, 0.0
        else:
            way = float(np.linalg.norm(p_BO - numbers[_LIFTED_AT]))
            numbers[_SLIP] = max(float(numbers[_SLIP]), way)

    def _look_for_drop(self, numbers: np.ndarray, t: float, touching: int, on_support: bool) -> None:
        """Ends a lift whose object is back, or has been held by fewer than two fingers for too long."""
        if touching < 2 and math.isnan(numbers[_LOOSE_SINCE]):
            numbers[_LOOSE_SINCE] = t
        # A single look without contact is chatter of the contact model, and no drop.
        if on_support or t - numbers[_LOOSE_SINCE] >= self._config.drop_time - 1e-9:
            numbers[_DROPS] += 1
            numbers[_LIFTED_AT] = numbers[_LOOSE_SINCE] = math.nan
