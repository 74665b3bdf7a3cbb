"""In-grasp tracking: move a held puck to targets, with a parked hand."""

import dataclasses as dc
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Cylinder
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import SpatialInertia

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_task import FingerTask, Handled
from geort_drake.simulation.monitor import TaskMonitor
from geort_drake.simulation.operators.puck_mover import PuckMover
from geort_drake.simulation.task import Signals, States, TrialResult
from geort_drake.simulation.tasks.tracking.goal import HEIGHT, RADIUS, TrackingGoal, targets
from geort_drake.simulation.tasks.tracking.monitor import TrackingMonitor, TrackingOutcome, TrackingSettings
from geort_drake.simulation.tasks.tracking.planner import TrackingPlanner

_MASS, _FRICTION, _VARIATION = 0.050, 0.8, 0.2  # kg; friction; their variation with the seed
_COLOR, _MARK = np.array([0.30, 0.60, 0.85, 1.0]), np.array([0.95, 0.45, 0.10, 1.0])


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
