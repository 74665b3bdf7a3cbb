"""In-grasp tracking: move a held puck to targets, with a parked hand."""

import dataclasses as dc
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Cylinder
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import Context

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_task import FingerTask, Handled
from geort_drake.simulation.monitor import Outcome, TaskMonitor, TaskSettings
from geort_drake.simulation.operators.puck_mover import PuckMover
from geort_drake.simulation.task import Signals, States, TrialResult
from geort_drake.simulation.tasks.tracking.planner import (
    HEIGHT,
    RADIUS,
    TrackingGoal,
    TrackingPlanner,
    targets,
)
from geort_drake.systems.port_values import pose_to_vector, vector_to_pose

_MASS, _FRICTION, _VARIATION = 0.050, 0.8, 0.2  # kg; friction; their variation with the seed
_COLOR, _MARK = np.array([0.30, 0.60, 0.85, 1.0]), np.array([0.95, 0.45, 0.10, 1.0])


@dc.dataclass(frozen=True)
class TrackingSettings(TaskSettings):
    """Number and time of the targets, and criteria for one to count."""

    # Number of targets, number needed for success, and longest time of each, s.
    targets: float = 10
    enough: float = 5
    target_time: float = 6.0
    # A target is reached when the puck stays within `distance`, m, and `angle` of its axis, degrees, for
    # `hold_time`, s.
    distance: float = 0.003
    angle: float = 6.0
    hold_time: float = 0.5
    # Time until the stand releases the puck and the first target is cued, s; and distance from the grip at
    # which the puck counts as dropped, m.
    ready_time: float = 8.0
    dropped: float = 0.04


@dc.dataclass(frozen=True)
class TrackingOutcome(Outcome):
    """The targets so far; times in s."""

    settings: TrackingSettings
    times: tuple[float, ...] = ()  # time to reach each past target; NaN if missed
    bits: float = 0.0  # sum of the reached targets' indices of difficulty
    difficulty: float = 0.0  # index of difficulty of the present target, bits
    cued_since: float = math.nan  # when the present target was cued; NaN before the first
    reached_since: float = math.nan  # when the puck came to its target; NaN while it is elsewhere
    is_dropped: bool = False

    @property
    def reached(self) -> int:
        """Number of targets reached."""
        return sum(not math.isnan(time) for time in self.times)

    @property
    def score(self) -> float:
        """Fraction of the targets reached."""
        return self.reached / round(self.settings.targets)

    @property
    def success(self) -> bool:
        """Whether the puck was held to the end and enough targets were reached."""
        return self.over and not self.is_dropped and self.reached >= self.settings.enough

    @property
    def over(self) -> bool:
        """Whether all targets are over or the puck is dropped."""
        return self.is_dropped or len(self.times) == round(self.settings.targets)


class TrackingMonitor(TaskMonitor[TrackingOutcome]):
    """Cues one target after another, watches the puck, and terminates a decided simulation.

    Input ports, besides those of `TaskMonitor`:
        object_pose (7): X_WO of the puck, qw qx qy qz x y z.
    Output ports:
        cue (1): number of the target among those of the trial, from 1; 0 for none.
        target_pose (7): X_WT of the target, qw qx qy qz x y z; without a target, of the grip.
        error (2): distance of the puck from the target, mm, and angle between their axes, degrees.
        outcome (abstract TrackingOutcome).

    Args:
        X_WG: pose of the grip.
        cued: numbers of the targets in the order of their cues, from 0.
    """

    def __init__(
        self, num_fingers: int, X_WG: RigidTransform, cued: Sequence[int], settings: TrackingSettings
    ):
        super().__init__(num_fingers, TrackingOutcome(settings))
        self._X_WG = X_WG
        self._X_WT = [X_WG @ targets()[number] for number in cued]
        self._pose = self.DeclareVectorInputPort("object_pose", 7)
        self._declare_output(
            "cue", 1, lambda outcome: 0 if math.isnan(outcome.cued_since) else len(outcome.times) + 1
        )
        self._declare_output("target_pose", 7, lambda outcome: pose_to_vector(self._target(outcome)))
        self.DeclareVectorOutputPort(
            "error",
            2,
            lambda context, output: output.SetFromVector(
                [1e3, 1] * self._error(context, self.outcome(context))
            ),
            {*self._outcome_tickets, self._pose.ticket()},
        )

    def _target(self, outcome: TrackingOutcome) -> RigidTransform:
        return (
            self._X_WG if math.isnan(outcome.cued_since) or outcome.over else self._X_WT[len(outcome.times)]
        )

    def _error(self, context: Context, outcome: TrackingOutcome) -> np.ndarray:
        """Returns distance, m, and angle, degrees, between the puck and its target; (2,)."""
        X_TO = self._target(outcome).inverse() @ vector_to_pose(self._pose.Eval(context))
        x, y, z = X_TO.rotation().matrix()[:, 2]
        return np.array([np.linalg.norm(X_TO.translation()), math.degrees(math.atan2(math.hypot(x, y), z))])

    def _judged(self, context: Context, before: TrackingOutcome) -> TrackingOutcome:
        settings, t = before.settings, before.t
        if t < before.began + settings.ready_time - 1e-9:
            return before
        displacement = vector_to_pose(self._pose.Eval(context)).translation() - self._X_WG.translation()
        if np.linalg.norm(displacement) > settings.dropped:
            return before.having(is_dropped=True)
        if math.isnan(before.cued_since):
            return self._cued(before, context)
        error = self._error(context, before)
        at_target = error[0] < settings.distance and error[1] < settings.angle
        since = t if math.isnan(before.reached_since) else before.reached_since
        reached_since = since if at_target else math.nan
        if t - reached_since > settings.hold_time - 1e-9:
            bits, time = before.bits + before.difficulty, t - before.cued_since
        elif t - before.cued_since > settings.target_time - 1e-9:
            bits, time = before.bits, math.nan
        else:
            return before.having(reached_since=reached_since)
        return self._cued(before.having(times=(*before.times, time), bits=bits), context)

    def _cued(self, outcome: TrackingOutcome, context: Context) -> TrackingOutcome:
        """Cues the next target, whose difficulty is log2(1 + distance / width), see Fitts 1954."""
        now = outcome.having(cued_since=outcome.t, reached_since=math.nan)
        settings = outcome.settings
        relative_error = self._error(context, now) / [2 * settings.distance, 2 * settings.angle]
        return now.having(difficulty=math.log2(1 + relative_error.max()))


@dc.dataclass(frozen=True)
class TrackingResult(TrialResult):
    """Result of one trial of tracking. `outcome` is "success", "dropped", or the number of targets."""

    # Targets reached; whether the puck was dropped; mean time to a reached target, s; and bits of reached
    # targets per s spent on all. None without a target.
    reached: int
    dropped: bool
    target_time: float | None
    throughput: float | None


class TrackingTask(FingerTask[TrackingGoal]):
    """Move a puck between three fingertips to targets."""

    name = "tracking"
    summary = "move a puck between three fingertips to targets"
    result = TrackingResult
    scenario = Path(__file__).with_name("scenario.yaml"), "Tracking"
    settings = TrackingSettings
    planner = TrackingPlanner
    person_type = PuckMover
    percepts = ("object_pose", "target_pose", "cue", "contact")

    def add_handled(
        self, plant: MultibodyPlant, goal: TrackingGoal, X_WB: RigidTransform, rng: np.random.Generator
    ) -> Handled:
        """Adds the puck, which starts at X_WG, with a mark on one face."""
        X_WG = X_WB @ goal.X_BG
        mass_factor, friction_factor = rng.uniform(1 - _VARIATION, 1 + _VARIATION, 2)
        model = plant.AddModelInstance("puck")
        inertia = SpatialInertia.SolidCylinderWithMass(mass_factor * _MASS, RADIUS, HEIGHT, [0.0, 0.0, 1.0])
        puck = plant.AddRigidBody("puck", model, inertia)
        plant.SetDefaultFloatingBaseBodyPose(puck, X_WG)
        friction = CoulombFriction(friction_factor * _FRICTION, friction_factor * _FRICTION)
        shape, place = Cylinder(RADIUS, HEIGHT), RigidTransform()
        plant.RegisterCollisionGeometry(puck, place, shape, "puck", friction)
        plant.RegisterVisualGeometry(puck, place, shape, "puck", _COLOR)
        top = RigidTransform([0, 0, -HEIGHT / 2])
        plant.RegisterVisualGeometry(puck, top, Cylinder(RADIUS / 3, 0.001), "mark", _MARK)
        return Handled(puck, X_WO=X_WG, outline=_outline())

    def make_monitor(
        self,
        num_fingers: int,
        goal: TrackingGoal,
        X_WB: RigidTransform,
        settings: TrackingSettings,
        rng: np.random.Generator,
    ) -> TrackingMonitor:
        number, known = round(settings.targets), len(targets())
        cued = np.concatenate([rng.permutation(known) for _ in range(0, number, known)])[:number]
        return TrackingMonitor(num_fingers, X_WB @ goal.X_BG, cued.tolist(), settings)

    def recorded(self, monitor: TaskMonitor, settings: TrackingSettings) -> tuple[States, Signals]:
        names = ["none", *(f"target {number + 1}" for number in range(round(settings.targets)))]
        error = monitor.GetOutputPort("error"), ["distance, mm", "angle, degrees"], ""
        return {"cue": (monitor.GetOutputPort("cue"), names)}, {"tracking/error": error}

    def result_fields(self, outcome: TrackingOutcome, description: HandDescription) -> dict[str, Any]:
        missing = "dropped" if outcome.is_dropped else f"{outcome.reached} of {len(outcome.times)} targets"
        times = [time for time in outcome.times if not np.isnan(time)]
        spent = sum(times) + (len(outcome.times) - len(times)) * outcome.settings.target_time
        return {
            "outcome": "success" if outcome.success else missing,
            "reached": outcome.reached,
            "dropped": outcome.is_dropped,
            "target_time": float(np.mean(times)) if times else None,
            "throughput": outcome.bits / spent if spent else None,
        }


def _outline(points: int = 32) -> np.ndarray:
    """Returns points (N, 3) on the edges of both faces of the puck, m in O."""
    angle = np.linspace(0, 2 * np.pi, points, endpoint=False)
    x, y = RADIUS * np.cos(angle), RADIUS * np.sin(angle)
    return np.vstack([np.column_stack([x, y, np.full(points, z)]) for z in (-HEIGHT / 2, HEIGHT / 2)])


TASK = TrackingTask()
