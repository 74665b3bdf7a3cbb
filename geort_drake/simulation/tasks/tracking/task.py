"""In-grasp tracking: move a held puck to targets, with a parked hand."""

import dataclasses as dc
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Cylinder
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import RigidBody, SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_task import FingerTask
from geort_drake.simulation.held_stage import HeldStage, add_stand
from geort_drake.simulation.operators.puck_mover import PuckMover
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import PerceivedPort, Stage, Target, TrialResult
from geort_drake.simulation.tasks.tracking.goal import HEIGHT, RADIUS, TrackingGoal, targets
from geort_drake.simulation.tasks.tracking.monitor import TrackingMonitor, TrackingOutcome, TrackingSettings
from geort_drake.simulation.tasks.tracking.planner import TrackingPlanner
from geort_drake.simulation.view import add_view, shown_by
from geort_drake.simulation.world import add_robot, finish_scene
from geort_drake.systems.port_values import POSE_MIRROR

_MASS, _FRICTION, _VARIATION = 0.050, 0.8, 0.2  # kg, and friction; both vary by this fraction with the seed
_COLOR, _MARK = np.array([0.30, 0.60, 0.85, 1.0]), np.array([0.95, 0.45, 0.10, 1.0])


@dc.dataclass(frozen=True)
class TrackingResult(TrialResult):
    """Result of one trial of tracking. `outcome` is "success", "dropped", or the targets reached."""

    # Targets reached, whether the puck was dropped, mean time to a target, s, and bits of the reached targets
    # per s of all. None without a target.
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

    def places(self, goal: TrackingGoal) -> Sequence[np.ndarray]:
        return goal.places()

    def percepts(self, goal: TrackingGoal) -> dict[str, int]:
        return {"object_pose": 7, "target_pose": 7, "cue": 1, "contact": len(goal.finger_names)}

    def add_stage(
        self,
        builder: DiagramBuilder,
        scenario: Scenario,
        description: HandDescription,
        goal: TrackingGoal | None,
        X_WB: RigidTransform,
        rng: np.random.Generator,
    ) -> Stage:
        goal = goal or self.plans(scenario, description)[0]
        settings = TrackingSettings(**scenario.task_settings)
        plant, scene_graph = AddMultibodyPlant(scenario.plant_config, builder)
        add_robot(plant, scenario, description)
        X_WG = X_WB @ goal.X_BG
        puck = _add_puck(plant, X_WG, *rng.uniform(1 - _VARIATION, 1 + _VARIATION, 2))
        scene = finish_scene(plant, scene_graph, scenario, description, puck.model_instance())
        view = add_view(builder, scene, description, puck)
        stand = add_stand(builder, plant, puck, X_WG, settings.ready_time)
        number = round(settings.targets)
        cued = np.concatenate([rng.permutation(len(targets())) for _ in range(0, number, len(targets()))])
        monitor = builder.AddNamedSystem(
            "tracking_monitor",
            TrackingMonitor(len(description.fingers), X_WG, cued[:number].tolist(), settings),
        )
        for name in ("object_pose", "contact", "self_contact"):
            builder.Connect(view.GetOutputPort(name), monitor.GetInputPort(name))
        shown = {
            **shown_by(view, len(description.fingers), "fingertips", "hand_pose", "object_pose", "contact"),
            "target_pose": PerceivedPort(monitor.GetOutputPort("target_pose"), POSE_MIRROR),
            "cue": PerceivedPort(monitor.GetOutputPort("cue")),
        }
        names = ["none", *(f"target {number + 1}" for number in range(len(cued)))]
        return HeldStage(
            scene,
            monitor,
            shown,
            {"cue": (monitor.GetOutputPort("cue"), names)},
            [puck],
            {"tracking/error": (monitor.GetOutputPort("error"), ["distance, mm", "angle, degrees"], "")},
            target=Target(puck, monitor.GetOutputPort("target_pose"), _outline()),
            stand=stand,
            ready_time=settings.ready_time,
        )

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
    """The edges of both faces of the puck."""
    angle = np.linspace(0, 2 * np.pi, points, endpoint=False)
    x, y = RADIUS * np.cos(angle), RADIUS * np.sin(angle)
    return np.vstack([np.column_stack([x, y, np.full(points, z)]) for z in (-HEIGHT / 2, HEIGHT / 2)])


def _add_puck(
    plant: MultibodyPlant, X_WG: RigidTransform, mass_factor: float, friction_factor: float
) -> RigidBody:
    """Adds the puck, which starts at X_WG, with a mark on one face."""
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
    return puck


TASK = TrackingTask()
