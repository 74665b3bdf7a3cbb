"""Cues pulls of the trigger and judges them: the pad must be held half way, the handle stay still."""

import dataclasses as dc
import math

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from geort_drake.simulation.monitor import Outcome, TaskMonitor, TaskSettings
from geort_drake.systems.port_values import vector_to_pose

CUES = ("none", "pull", "release")


@dc.dataclass(frozen=True)
class TriggerSettings(TaskSettings):
    """Number and time of the pulls, and criteria for one to count."""

    # Number of pulls, each followed by a release; and how long the pad must be held, s.
    pulls: float = 5
    hold_time: float = 2.0
    # Wanted travel of the pad, its tolerance, and the travel below which the pad counts as released, m.
    depth: float = 0.004
    tolerance: float = 0.001
    released: float = 0.001
    # Time until the stand releases the handle, and from then until the handle must keep its pose, s. It is
    # lost once it has moved from that pose by more than `handle_shift`, m, or `handle_turn`, degrees.
    ready_time: float = 5.0
    settle_time: float = 1.0
    handle_shift: float = 0.010
    handle_turn: float = 10.0


@dc.dataclass(frozen=True)
class TriggerOutcome(Outcome):
    """The pulls so far; times in s, lengths in m."""

    settings: TriggerSettings
    cue: int = 0  # see `CUES`
    done: int = 0  # pulls that were held and released
    held_since: float = math.nan  # when the pad came within tolerance; NaN while it is outside
    X_WH: RigidTransform | None = None  # pose that the handle must keep
    shift: float = 0.0  # largest motion of the handle
    turn: float = 0.0  # largest turn of the handle, degrees
    is_lost: bool = False

    @property
    def score(self) -> float:
        """Fraction of the pulls that are done."""
        return self.done / round(self.settings.pulls)

    @property
    def success(self) -> bool:
        """Whether all pulls are done."""
        return self.done == round(self.settings.pulls)

    @property
    def over(self) -> bool:
        """Whether all pulls are done or the handle is lost."""
        return self.success or self.is_lost


class TriggerMonitor(TaskMonitor[TriggerOutcome]):
    """Cues pulls and releases, watches pad and handle, and terminates a decided simulation.

    Input ports, besides those of `TaskMonitor`:
        joints (2): travel of the pad, m, and its speed.
        object_pose (7): X_WH of the handle, qw qx qy qz x y z.
    Output ports:
        cue (1): number of one of `CUES`.
        travel (1): travel of the pad, m.
        outcome (abstract TriggerOutcome).
    """

    def __init__(self, num_fingers: int, settings: TriggerSettings):
        super().__init__(num_fingers, TriggerOutcome(settings))
        self._pad = self.DeclareVectorInputPort("joints", 2)
        self._pose = self.DeclareVectorInputPort("object_pose", 7)
        self._declare_output("cue", 1, lambda outcome: outcome.cue)
        self._declare_positions("travel", self._pad)

    def _judged(self, context: Context, before: TriggerOutcome) -> TriggerOutcome:
        outcome = self._with_handle(before, vector_to_pose(self._pose.Eval(context)))
        if outcome.X_WH is None or outcome.is_lost:
            return outcome
        return self._with_pad(outcome, float(self._pad.Eval(context)[0]))

    def _with_handle(self, before: TriggerOutcome, X_WH: RigidTransform) -> TriggerOutcome:
        settings = before.settings
        if before.X_WH is None:
            is_settled = before.t > before.began + settings.ready_time + settings.settle_time - 1e-9
            return before.having(X_WH=X_WH, cue=1) if is_settled else before
        X_HH = before.X_WH.inverse() @ X_WH
        shift = float(np.linalg.norm(X_HH.translation()))
        turn = math.degrees(abs(X_HH.rotation().ToAngleAxis().angle()))
        return before.having(
            shift=max(before.shift, shift),
            turn=max(before.turn, turn),
            is_lost=shift > settings.handle_shift or turn > settings.handle_turn,
        )

    def _with_pad(self, before: TriggerOutcome, travel: float) -> TriggerOutcome:
        settings = before.settings
        if before.cue == 2:
            return before if travel > settings.released else before.having(cue=1, done=before.done + 1)
        if abs(travel - settings.depth) > settings.tolerance:
            return before.having(held_since=math.nan)
        if math.isnan(before.held_since):
            return before.having(held_since=before.t)
        is_held = before.t - before.held_since > settings.hold_time - 1e-9
        return before.having(cue=2, held_since=math.nan) if is_held else before
