"""Judges a grasp from the physics alone: lifted and held, or failed, and in which phase."""

import dataclasses as dc
import enum
import math
from collections.abc import Callable

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from geort_drake.systems.poses import vector_to_pose
from geort_drake.systems.unchanging import Unchanging


class GraspPhase(enum.IntEnum):
    """How far the grasp has come; a trial that fails is named after the phase it was in."""

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

    def validate(self) -> None:
        """Raises ValueError for values that cannot work."""
        for field in dc.fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"monitor.{field.name} must be positive and finite, not {value}")


@dc.dataclass(frozen=True)
class GraspOutcome(Unchanging):
    """What has come of the grasp so far; times in s since the start, NaN where it has not happened."""

    phase: GraspPhase = GraspPhase.REACH
    # First entry of each phase, by its name, and the time spent in it altogether.
    times: dict[str, float] = dc.field(default_factory=dict)
    durations: dict[str, float] = dc.field(default_factory=dict)
    # The present time above the height began here; NaN while lower.
    held_since: float = float("nan")
    drops: int = 0
    # Furthest way of the object's origin in the hand base's frame since the last lift began, m; NaN where
    # nothing was lifted.
    slip: float = float("nan")
    peak_force: float = 0.0
    peak_height: float = 0.0

    @property
    def success(self) -> bool:
        """Whether the object was held high enough for long enough."""
        return self.phase == GraspPhase.DONE

    @property
    def over(self) -> bool:
        """Whether nothing more can come of the trial."""
        return self.phase in (GraspPhase.DONE, GraspPhase.THROWN)

    @property
    def completion_time(self) -> float:
        """Start to the beginning of the successful hold, s; NaN without success."""
        return self.held_since if self.success else float("nan")


class GraspMonitor(LeafSystem):
    """Watches object and contacts, without delay or noise, and keeps the outcome.

    Input ports (F fingers):
        object_pose (7): X_WO, qw qx qy qz x y z.
        hand_pose (7): X_WB of the robot's hand base.
        contact (F): force between each finger and the object, N.
    Output ports:
        phase (1): `GraspPhase` as a number.
        outcome (abstract GraspOutcome).

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
        self._outcome = self.DeclareAbstractState(AbstractValue.Make(GraspOutcome()))
        self._start = self.DeclareDiscreteState(np.full(3, np.nan))
        self._p_BO_lifted = self.DeclareDiscreteState(np.full(3, np.nan))
        ticket = {self.abstract_state_ticket(self._outcome)}
        self.DeclareVectorOutputPort(
            "phase",
            1,
            lambda context, output: output.SetAtIndex(0, float(self.outcome(context).phase)),
            ticket,
        )
        self.DeclareStateOutputPort("outcome", self._outcome)
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._look)

    def outcome(self, context: Context) -> GraspOutcome:
        """The outcome so far."""
        return context.get_abstract_state(self._outcome).get_value()

    def _look(self, context: Context, state) -> EventStatus:
        before = self.outcome(context)
        if before.over:
            return EventStatus.DidNothing()
        config, t = self._config, context.get_time()
        pose = self._object_pose.Eval(context)
        force = self._contact.Eval(context)
        start = context.get_discrete_state(self._start).value()
        if np.isnan(start).any():
            start = pose[4:].copy()
            state.get_mutable_discrete_state(self._start).set_value(start)
        height = self._lowest_point(vector_to_pose(pose)) - self._support
        touching = int((force > config.touch_force).sum())
        strayed = float(np.linalg.norm(pose[4:6] - start[:2])) > config.strayed
        held_since = before.held_since
        if height >= config.height and touching >= 2:
            phase = GraspPhase.HOLD
            held_since = t if np.isnan(held_since) else held_since
            if t - held_since >= config.hold_time:
                phase = GraspPhase.DONE
        else:
            held_since = float("nan")
            if height < -config.fallen or (strayed and touching == 0):
                phase = GraspPhase.THROWN
            elif height > config.lifted and touching >= 2:
                phase = GraspPhase.LIFT
            else:
                phase = GraspPhase(min(touching, 2))
        lifted = (GraspPhase.LIFT, GraspPhase.HOLD, GraspPhase.DONE)
        slip = before.slip
        if phase in lifted:
            X_WB = vector_to_pose(self._hand_pose.Eval(context))
            p_BO = X_WB.inverse().multiply(pose[4:])
            if before.phase in lifted:
                p_BO_lifted = context.get_discrete_state(self._p_BO_lifted).value()
                slip = max(slip, float(np.linalg.norm(p_BO - p_BO_lifted)))
            else:
                state.get_mutable_discrete_state(self._p_BO_lifted).set_value(p_BO)
                slip = 0.0
        times = before.times
        if phase.name not in times:
            times = {**times, phase.name: t}
        durations = before.durations
        if t > 0:
            spent = durations.get(before.phase.name, 0.0) + config.period
            durations = {**durations, before.phase.name: spent}
        outcome = GraspOutcome(
            phase=phase,
            times=times,
            durations=durations,
            held_since=held_since,
            drops=before.drops + int(before.phase in lifted and phase < GraspPhase.GRASP),
            slip=slip,
            peak_force=max(before.peak_force, float(force.max())),
            peak_height=max(before.peak_height, float(height)),
        )
        state.get_mutable_abstract_state(self._outcome).set_value(outcome)
        return EventStatus.Succeeded()
