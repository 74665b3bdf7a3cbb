"""The cap: unscrew it with three fingers, which must let go and grip again."""

import dataclasses as dc
import math
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Box, Cylinder
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PdControllerGains,
    ScrewJoint,
    SpatialInertia,
)
from pydrake.systems.framework import Context

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_task import FingerTask, Handled
from geort_drake.simulation.monitor import Outcome, TaskMonitor, TaskSettings
from geort_drake.simulation.operators.cap_turner import CapTurner
from geort_drake.simulation.task import Signals, States, TrialResult
from geort_drake.simulation.tasks.cap.planner import HEIGHT, RADIUS, CapGoal, CapPlanner

STEPS = 8  # number of steps into which recordings divide the turn
_MASS, _PITCH = 0.040, 0.004  # kg; m per turn
_THREAD_FRICTION = 0.03  # N m
_FRICTION, _VARIATION = 0.8, 0.2  # of the cap; fraction by which friction and brake vary with the seed
_NECK, _NECK_HEIGHT = 0.017, 0.10  # m, radius and height of the bottle's neck
_COLOR, _RIB_COLOR = np.array([0.95, 0.45, 0.10, 1.0]), np.array([0.75, 0.33, 0.05, 1.0])
_NECK_COLOR = np.array([0.75, 0.80, 0.85, 1.0])


@dc.dataclass(frozen=True)
class CapSettings(TaskSettings):
    """The turn that counts as unscrewed."""

    turn: float = 360.0  # degrees


@dc.dataclass(frozen=True)
class CapOutcome(Outcome):
    """How far the cap has been turned."""

    settings: CapSettings
    turned: float = 0.0  # degrees

    @property
    def score(self) -> float:
        """Fraction of the turn that is done."""
        return min(max(self.turned / self.settings.turn, 0.0), 1.0)

    @property
    def success(self) -> bool:
        """Whether the cap is off."""
        return self.turned >= self.settings.turn

    @property
    def over(self) -> bool:
        """Whether the cap is off."""
        return self.success


class CapMonitor(TaskMonitor[CapOutcome]):
    """Watches the cap, and terminates the simulation when it is off.

    Input port, besides those of `TaskMonitor`:
        joints (2): turn of the cap, rad, and its speed.
    Output ports:
        turned (1): turn of the cap, rad.
        step (1): number of completed steps, of STEPS equal ones.
        outcome (abstract CapOutcome).
    """

    def __init__(self, num_fingers: int, settings: CapSettings):
        super().__init__(num_fingers, CapOutcome(settings))
        self._cap = self.DeclareVectorInputPort("joints", 2)
        self._declare_positions("turned", self._cap)
        self._declare_output("step", 1, lambda outcome: int(STEPS * outcome.score))

    def _judged(self, context: Context, before: CapOutcome) -> CapOutcome:
        return before.having(turned=math.degrees(self._cap.Eval(context)[0]))


@dc.dataclass(frozen=True)
class CapResult(TrialResult):
    """Result of one trial of the cap. `outcome` is "success", or how far the cap was turned."""

    turned: float  # degrees


class CapTask(FingerTask[CapGoal]):
    """Unscrew a cap with three fingers."""

    name = "cap"
    summary = "unscrew a cap with three fingers, which grip again and again"
    result = CapResult
    scenario = Path(__file__).with_name("scenario.yaml"), "Cap"
    settings = CapSettings
    planner = CapPlanner
    monitor_type = CapMonitor
    person_type = CapTurner
    percepts = ("turned", "contact")

    def add_handled(
        self, plant: MultibodyPlant, goal: CapGoal, X_WB: RigidTransform, rng: np.random.Generator
    ) -> Handled:
        """Adds a cap on the neck of a bottle; the cap rises along −x of B when it is unscrewed.

        The cap's frame has z along its axis, upwards.
        """
        friction_factor, brake_factor = rng.uniform(1 - _VARIATION, 1 + _VARIATION, 2)
        model = plant.AddModelInstance("bottle")
        X_WC = X_WB @ RigidTransform(RotationMatrix.MakeYRotation(-math.pi / 2), goal.p_BC)
        neck = plant.AddRigidBody(
            "neck", model, SpatialInertia.SolidCylinderWithMass(0.1, _NECK, _NECK_HEIGHT, [0, 0, 1])
        )
        X_CN = RigidTransform([0.0, 0.0, -(HEIGHT + _NECK_HEIGHT) / 2])
        plant.WeldFrames(plant.world_frame(), neck.body_frame(), X_WC @ X_CN)
        cap = plant.AddRigidBody(
            "cap", model, SpatialInertia.SolidCylinderWithMass(_MASS, RADIUS, HEIGHT, [0, 0, 1])
        )
        joint = plant.AddJoint(
            ScrewJoint(
                "thread",
                plant.AddFrame(FixedOffsetFrame("thread_start", neck, X_CN.inverse())),
                cap.body_frame(),
                [0.0, 0.0, 1.0],
                _PITCH,
                0.0,
            )
        )
        # Drake has no dry friction in joints: a strong damper of limited torque sticks like one.
        brake = plant.AddJointActuator("brake", joint, brake_factor * _THREAD_FRICTION)
        brake.set_controller_gains(PdControllerGains(p=1e-6, d=50.0))
        friction = CoulombFriction(friction_factor * _FRICTION, friction_factor * _FRICTION)
        shapes = ((neck, Cylinder(_NECK, _NECK_HEIGHT), _NECK_COLOR), (cap, Cylinder(RADIUS, HEIGHT), _COLOR))
        for body, shape, color in shapes:
            plant.RegisterCollisionGeometry(body, RigidTransform(), shape, body.name(), friction)
            plant.RegisterVisualGeometry(body, RigidTransform(), shape, body.name(), color)
        # A mark that makes the turn visible.
        plant.RegisterVisualGeometry(
            cap, RigidTransform([RADIUS / 2, 0, 0]), Box(RADIUS, 0.004, HEIGHT + 0.001), "mark", _RIB_COLOR
        )
        return Handled(cap, joints=[joint])

    def recorded(self, monitor: TaskMonitor, settings: CapSettings) -> tuple[States, Signals]:
        steps = [f"{angle:.0f}°" for angle in np.linspace(0, settings.turn, STEPS + 1)]
        turned = monitor.GetOutputPort("turned"), ["cap"], "rad"
        return {"cap": (monitor.GetOutputPort("step"), steps)}, {"cap/turned": turned}

    def result_fields(self, outcome: CapOutcome, description: HandDescription) -> dict[str, Any]:
        missing = f"turned by {outcome.turned:.0f}°"
        return {"outcome": "success" if outcome.success else missing, "turned": outcome.turned}


TASK = CapTask()
