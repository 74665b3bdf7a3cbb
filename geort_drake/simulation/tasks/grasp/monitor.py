"""Judges a grasp from the simulated physics alone: held or failed, and in which phase."""

import dataclasses as dc
import enum
import math
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from geort_drake.settings import require_numbers
from geort_drake.simulation.monitor import Outcome, TaskMonitor
from geort_drake.systems.port_values import vector_to_pose


class GraspPhase(enum.IntEnum):
    """Phases of a grasp, as the monitor sees it."""

    REACH = 0  # nothing touches the object
    TOUCH = 1  # one finger touches
    GRASP = 2  # two or more fingers touch
    LIFT = 3  # ... and the object has left its support
    HOLD = 4  # ... and the object is high enough
    DONE = 5  # ... and the object stayed there long enough
    THROWN = 6  # the object lies off its support, out of reach


_LIFTED = (GraspPhase.LIFT, GraspPhase.HOLD, GraspPhase.DONE)
OVER = (GraspPhase.DONE, GraspPhase.THROWN)
_TIME_TOLERANCE = 1e-9  # s; sums of periods are rounded


@dc.dataclass
class GraspMonitorConfig:
    """Criteria of a successful grasp."""

    # Time between two checks, s.
    period: float = 0.01
    # The object's lowest point must be this high above its support, m, for this long, s.
    height: float = 0.10
    hold_time: float = 2.0
    # Height above which the object has left its support, m.
    lifted: float = 0.005
    # The object was thrown if it is this far below its support, or this far from its start and untouched, m.
    fallen: float = 0.03
    strayed: float = 0.30
    # Contact force above which a finger touches, N.
    touch_force: float = 0.02
    # A lifted object was dropped if fewer than two fingers have touched it for this long, s.
    drop_time: float = 0.1

    def validate(self) -> None:
        """Raises ValueError for a value out of range."""
        require_numbers(self, "monitor")


@dc.dataclass(frozen=True)
class GraspOutcome(Outcome):
    """The grasp so far; times in s since the start, NaN for events that have not happened."""

    phase: GraspPhase = GraspPhase.REACH
    # Phase name → time of its first entry, and total time spent in it.
    times: dict[str, float] = dc.field(default_factory=dict)
    durations: dict[str, float] = dc.field(default_factory=dict)
    # When the object became high enough; NaN while it is lower.
    held_since: float = math.nan
    # Link of the hand → time for which it has touched the object since then, s.
    holding: dict[str, float] = dc.field(default_factory=dict)
    # Last phase in which a finger touched the object, except phases that end a trial.
    last_touched: GraspPhase = GraspPhase.REACH
    # Lifts that ended: back on the support, or fewer than two fingers touched it for `drop_time`.
    drops: int = 0
    # Largest displacement of the object's origin in B since the last lift began, m; NaN without a lift. A
    # lift begins with the phase LIFT and ends with a drop.
    slip: float = math.nan
    peak_height: float = 0.0
    # The object's first position; during a lift, p_BO at its start, and since when fewer than two fingers
    # have touched the object.
    p_WO_start: np.ndarray | None = None
    p_BO_lifted: np.ndarray | None = None
    loose_since: float = math.nan

    @property
    def success(self) -> bool:
        """Whether the object was held high enough for long enough."""
        return self.phase == GraspPhase.DONE

    @property
    def score(self) -> float:
        """Furthest phase reached, as a fraction of DONE."""
        phases = [GraspPhase[name] for name in self.times]
        return max((phase for phase in phases if phase != GraspPhase.THROWN), default=0) / GraspPhase.DONE

    @property
    def over(self) -> bool:
        """Whether the grasp is decided."""
        return self.phase in OVER

    @property
    def completion_time(self) -> float:
        """Time from the start to the beginning of the successful hold, s; NaN without success."""
        return self.held_since if self.success else math.nan


class GraspMonitor(TaskMonitor[GraspOutcome]):
    """Judges a grasp from object pose and contacts, without delay or noise.

    Input ports, besides those of `TaskMonitor`, contact (F) and self_contact (1):
        object_pose (7): X_WO, qw qx qy qz x y z.
        hand_pose (7): X_WB of the robot's hand base.
        link_contact (L): force between each link of the hand and the object, N.
    Output ports:
        phase (1): `GraspPhase` as a number.
        outcome (abstract GraspOutcome).

    Args:
        links: names of the L links.
        lowest_point: maps X_WO to the height in W of the object's lowest point, m.
        support_height: height of the support in W, m.
    """

    def __init__(
        self,
        num_fingers: int,
        links: Sequence[str],
        lowest_point: Callable[[RigidTransform], float],
        support_height: float,
        config: GraspMonitorConfig,
    ):
        config.validate()
        super().__init__(num_fingers, GraspOutcome(), config.period)
        self._lowest_point, self._support, self._config = lowest_point, support_height, config
        self._object_pose = self.DeclareVectorInputPort("object_pose", 7)
        self._hand_pose = self.DeclareVectorInputPort("hand_pose", 7)
        self._links = np.array(links)
        self._link_contact = self.DeclareVectorInputPort("link_contact", len(links))
        self._declare_output("phase", 1, lambda outcome: outcome.phase)

    def _judged(self, context: Context, before: GraspOutcome) -> GraspOutcome:
        config, t = self._config, before.t
        X_WO = vector_to_pose(self._object_pose.Eval(context))
        force = self._contact.Eval(context).tolist()
        p_WO_start = X_WO.translation() if before.p_WO_start is None else before.p_WO_start
        height = self._lowest_point(X_WO) - self._support
        touching = sum(one > config.touch_force for one in force)
        x, y = (X_WO.translation() - p_WO_start)[:2].tolist()
        held_since, holding = math.nan, {}
        if height >= config.height and touching >= 2:
            held_since = t if math.isnan(before.held_since) else before.held_since
            links = self._links[self._link_contact.Eval(context) > config.touch_force].tolist()
            holding = before.holding | {link: before.holding.get(link, 0.0) + config.period for link in links}
            phase = GraspPhase.DONE if t - held_since >= config.hold_time else GraspPhase.HOLD
        elif height < -config.fallen or (math.hypot(x, y) > config.strayed and touching == 0):
            phase = GraspPhase.THROWN
        elif height > config.lifted and touching >= 2:
            phase = GraspPhase.LIFT
        else:
            phase = GraspPhase(min(touching, 2))

        drops, slip, p_BO_lifted, loose_since = before.drops, before.slip, before.p_BO_lifted, math.nan
        if phase in _LIFTED:
            p_BO = vector_to_pose(self._hand_pose.Eval(context)).inverse() @ X_WO.translation()
            if p_BO_lifted is None:
                p_BO_lifted, slip = p_BO, 0.0
            slip = max(slip, float(np.linalg.norm(p_BO - p_BO_lifted)))
        elif p_BO_lifted is not None:
            loose_since = before.loose_since
            if touching < 2 and math.isnan(loose_since):
                loose_since = t
            # A short loss of contact is chatter of the contact model, not a drop.
            if height <= config.lifted or t - loose_since >= config.drop_time - _TIME_TOLERANCE:
                drops, p_BO_lifted, loose_since = drops + 1, None, math.nan

        durations, name = before.durations, before.phase.name
        if t > 0:
            durations = {**durations, name: durations.get(name, 0.0) + config.period}
        return before.having(
            phase=phase,
            times={**before.times, phase.name: before.times.get(phase.name, t)},
            durations=durations,
            held_since=held_since,
            holding=holding,
            last_touched=phase if touching and phase not in OVER else before.last_touched,
            drops=drops,
            slip=slip,
            peak_height=max(before.peak_height, height),
            p_WO_start=p_WO_start,
            p_BO_lifted=p_BO_lifted,
            loose_since=loose_since,
        )
