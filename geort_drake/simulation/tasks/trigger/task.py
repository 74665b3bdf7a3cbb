"""The trigger: hold a handle while the index finger alone presses its pad half way."""

import dataclasses as dc
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Box, Cylinder, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PrismaticJoint,
    PrismaticSpring,
    SpatialInertia,
)

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_task import FingerTask, Handled
from geort_drake.simulation.monitor import TaskMonitor
from geort_drake.simulation.operators.trigger_puller import TriggerPuller
from geort_drake.simulation.task import Signals, States, TrialResult
from geort_drake.simulation.tasks.trigger.goal import BACK, LENGTH, RADIUS, TriggerGoal
from geort_drake.simulation.tasks.trigger.monitor import (
    CUES,
    TriggerMonitor,
    TriggerOutcome,
    TriggerSettings,
)
from geort_drake.simulation.tasks.trigger.planner import PAD_HEIGHT, PAD_TRAVEL, SUPPORT, TriggerPlanner

_MASS, _PAD_MASS = 0.150, 0.005  # kg
_FRICTION, _VARIATION = 0.8, 0.2  # of the handle; fraction by which mass and friction vary with the seed
_PAD = (0.006, 0.018, 0.024)  # m, size of the pad: along its travel, along the handle, across both
_STIFFNESS, _DAMPING = 200.0, 2.0  # N/m and N s/m of the pad; the damping is critical
_COLOR, _PAD_COLOR = np.array([0.25, 0.26, 0.28, 1.0]), np.array([0.95, 0.45, 0.10, 1.0])


@dc.dataclass(frozen=True)
class TriggerResult(TrialResult):
    """Result of one trial of the trigger. `outcome` is "success", "handle lost", or the number of pulls."""

    # Pulls that were held and released; largest motion of the handle, m, and its largest turn, degrees.
    pulls: int
    handle_shift: float
    handle_turn: float


class TriggerTask(FingerTask[TriggerGoal]):
    """Hold a handle while the index finger alone pulls its trigger."""

    name = "trigger"
    summary = "hold a handle while the index finger alone pulls its trigger"
    result = TriggerResult
    scenario = Path(__file__).with_name("scenario.yaml"), "Trigger"
    settings = TriggerSettings
    planner = TriggerPlanner
    monitor_type = TriggerMonitor
    person_type = TriggerPuller
    percepts = ("travel", "cue", "contact")

    def add_handled(
        self, plant: MultibodyPlant, goal: TriggerGoal, X_WB: RigidTransform, rng: np.random.Generator
    ) -> Handled:
        """Adds the handle with its pad on a spring.

        The handle's frame has x towards the fingers and y along its axis, as in B.
        """
        mass_factor, friction_factor = rng.uniform(1 - _VARIATION, 1 + _VARIATION, 2)
        model = plant.AddModelInstance("handle")
        inertia = SpatialInertia.SolidCylinderWithMass(mass_factor * _MASS, RADIUS, LENGTH, [0.0, 1.0, 0.0])
        friction = CoulombFriction(friction_factor * _FRICTION, friction_factor * _FRICTION)
        handle = plant.AddRigidBody("handle", model, inertia)
        y = np.array([0.0, 1.0, 0.0])
        R_BH = RotationMatrix(np.column_stack([goal.n_B, y, np.cross(goal.n_B, y)]))
        X_WH = X_WB @ RigidTransform(R_BH, goal.p_BH)
        plant.SetDefaultFloatingBaseBodyPose(handle, X_WH)
        upright = RotationMatrix.MakeXRotation(np.pi / 2)
        # A cylinder would rock on its single contact point with the palm. The handle rests on two spheres
        # instead, and its cylinder is 0.2 mm smaller.
        solid = Cylinder(RADIUS - 0.0002, LENGTH)
        plant.RegisterCollisionGeometry(handle, RigidTransform(upright, [0, 0, 0]), solid, "solid", friction)
        for end in (-SUPPORT, SUPPORT):
            X_HS = RigidTransform(R_BH.inverse() @ np.array([-BACK, 0.0, 0.0]) + [0.0, end, 0.0])
            ball = Sphere(RADIUS)
            plant.RegisterCollisionGeometry(handle, X_HS, ball, f"support {end}", friction)
            plant.RegisterVisualGeometry(handle, X_HS, ball, f"support {end}", _COLOR)
        shape = Cylinder(RADIUS, LENGTH)
        plant.RegisterVisualGeometry(handle, RigidTransform(upright, [0, 0, 0]), shape, "handle", _COLOR)
        pad = plant.AddRigidBody("pad", model, SpatialInertia.SolidBoxWithMass(_PAD_MASS, *_PAD))
        along = (goal.p_BF_open[goal.trigger] - goal.p_BH)[1]
        p_HP = [PAD_HEIGHT - _PAD[0] / 2, along, 0.0]
        joint = plant.AddJoint(
            PrismaticJoint(
                "pad",
                plant.AddFrame(FixedOffsetFrame("pad_rest", handle, RigidTransform(p_HP))),
                pad.body_frame(),
                [-1.0, 0.0, 0.0],
                0.0,
                PAD_TRAVEL,
                _DAMPING,
            )
        )
        plant.AddForceElement(PrismaticSpring(joint, 0.0, _STIFFNESS))
        plant.RegisterCollisionGeometry(pad, RigidTransform(), Box(*_PAD), "pad", friction)
        plant.RegisterVisualGeometry(pad, RigidTransform(), Box(*_PAD), "pad", _PAD_COLOR)
        return Handled(handle, [pad], [joint], X_WH)

    def recorded(self, monitor: TaskMonitor, settings: TriggerSettings) -> tuple[States, Signals]:
        travel = monitor.GetOutputPort("travel"), ["pad"], "m"
        return {"cue": (monitor.GetOutputPort("cue"), CUES)}, {"trigger/travel": travel}

    def result_fields(self, outcome: TriggerOutcome, description: HandDescription) -> dict[str, Any]:
        missing = (
            "handle lost" if outcome.is_lost else f"{outcome.done} of {outcome.settings.pulls:.0f} pulls"
        )
        return {
            "outcome": "success" if outcome.success else missing,
            "pulls": outcome.done,
            "handle_shift": outcome.shift,
            "handle_turn": outcome.turn,
        }


TASK = TriggerTask()
