"""Judges from the physics alone how far an object has come to its place, step by step."""

import dataclasses as dc
import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from geort_drake.simulation.monitor import TaskMonitor
from geort_drake.systems.port_values import Immutable, pose_to_vector, vector_to_pose

TOUCH_FORCE = 0.02  # N; a larger force is a touch
# The object is lost if it is this far below its support, or this far from its place and untouched, m.
_MAX_FALL, _MAX_OFFSET = 0.03, 0.4


class Look(NamedTuple):
    """An object relative to its support and its place; lengths in m, angles in rad."""

    height: float  # of its lowest point above the support
    offset: float  # horizontal distance from its place
    rise: float  # of its origin above its place
    turn: float  # angle about the vertical from its place
    tilt: float
    touching: int  # number of fingers


# How much of a step is done, from 0 to 1, at a look.
Progress = Callable[[Look], float]


@dc.dataclass(frozen=True)
class TransferOutcome(Immutable):
    """The steps so far; times in s since the start."""

    steps: tuple[str, ...]
    # Of the steps reached, in order: when each was.
    times: tuple[float, ...] = ()
    # Largest progress in the next step, below 1.
    progress: float = 0.0
    # The last step must stay done for `hold_time`; NaN while it is not.
    done_since: float = math.nan
    look: Look | None = None
    lost: bool = False
    peak_force: float = 0.0
    self_contact_time: float = 0.0

    @property
    def success(self) -> bool:
        """Whether all steps are reached."""
        return len(self.times) == len(self.steps)

    @property
    def over(self) -> bool:
        """Whether it is decided."""
        return self.success or self.lost

    @property
    def score(self) -> float:
        """Share of the steps that were reached, one after the other, with the progress in the next."""
        return (len(self.times) + self.progress * (not self.success)) / len(self.steps)

    @property
    def completion_time(self) -> float:
        """Time from the start until the last step was done, s; NaN without success."""
        return self.times[-1] if self.success else math.nan


class TransferMonitor(TaskMonitor[TransferOutcome]):
    """Watches an object on its way without delay or noise, and terminates a decided simulation.

    Input ports, besides those of `TaskMonitor`:
        object_pose (7): X_WO, qw qx qy qz x y z.
    Output ports:
        place_pose (7): X_WP, where the object belongs, qw qx qy qz x y z.
        step (1): number of steps reached.
        outcome (abstract TransferOutcome).

    Args:
        X_WP: where the object belongs.
        steps: name → progress; a step counts only after those before it.
        hold_time: for which the last step must stay done, s.
        symmetry: the object looks the same after turning by this angle about its z axis, rad.
        lowest_point: maps X_WO to the height in W of the object's lowest point, m.
        support_height: height of the support in W, m.
    """

    def __init__(
        self,
        num_fingers: int,
        X_WP: RigidTransform,
        steps: Mapping[str, Progress],
        hold_time: float,
        symmetry: float,
        lowest_point: Callable[[RigidTransform], float],
        support_height: float,
    ):
        super().__init__(num_fingers, TransferOutcome(tuple(steps)))
        self._progress, self._hold_time, self._symmetry = list(steps.values()), hold_time, symmetry
        self._X_WP, self._lowest_point, self._support = X_WP, lowest_point, support_height
        self._object_pose = self.DeclareVectorInputPort("object_pose", 7)
        place = pose_to_vector(X_WP)
        self.DeclareVectorOutputPort(
            "place_pose",
            7,
            lambda context, output: output.SetFromVector(place),
            {self.nothing_ticket()},
        )
        self.DeclareVectorOutputPort(
            "step",
            1,
            lambda context, output: output.SetAtIndex(0, len(self.outcome(context).times)),
            self._of_outcome,
        )

    def _seen(self, context: Context) -> Look:
        X_WO = vector_to_pose(self._object_pose.Eval(context))
        way = X_WO.translation() - self._X_WP.translation()
        R = self._X_WP.rotation().matrix().T @ X_WO.rotation().matrix()
        turn = math.remainder(math.atan2(R[1, 0], R[0, 0]), self._symmetry)
        return Look(
            height=self._lowest_point(X_WO) - self._support,
            offset=math.hypot(*way[:2]),
            rise=float(way[2]),
            turn=turn,
            tilt=math.acos(min(max(X_WO.rotation().matrix()[2, 2], -1.0), 1.0)),
            touching=int(np.sum(self._contact.Eval(context) > TOUCH_FORCE)),
        )

    def _judged(self, context: Context, before: TransferOutcome) -> TransferOutcome:
        t, look = context.get_time(), self._seen(context)
        times, progress, done_since = before.times, before.progress, math.nan
        now = self._progress[len(times)](look)
        progress = max(progress, now) if now < 1 else progress
        if len(times) < len(self._progress) - 1:
            if now >= 1:
                times, progress = (*times, t), 0.0
        elif now >= 1:
            done_since = t if math.isnan(before.done_since) else before.done_since
            if t - done_since > self._hold_time - 1e-9:
                times = (*times, done_since)
        return dc.replace(
            before,
            times=times,
            progress=progress,
            done_since=done_since,
            look=look,
            lost=look.height < -_MAX_FALL or (look.offset > _MAX_OFFSET and look.touching == 0),
        )
