"""The trigger: hold a handle while the index finger alone presses its pad half way."""

import dataclasses as dc
import math
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
from pydrake.systems.framework import Context

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_task import FingerTask, Handled
from geort_drake.simulation.monitor import Outcome, TaskMonitor, TaskSettings
from geort_drake.simulation.operators.trigger_puller import TriggerPuller
from geort_drake.simulation.task import Signals, States, TrialResult
from geort_drake.simulation.tasks.trigger.planner import (
    BACK,
    LENGTH,
    PAD_HEIGHT,
    PAD_TRAVEL,
    RADIUS,
    SUPPORT,
    TriggerGoal,
    TriggerPlanner,
)
from geort_drake.systems.port_values import vector_to_pose

CUES = ("none", "pull", "release")
_MASS, _PAD_MASS = 0.150, 0.005  # kg
_FRICTION, _VARIATION = 0.8, 0.2  # of the handle; fraction by which mass and friction vary with the seed
_PAD = (0.006, 0.018, 0.024)  # m, size of the pad: along its travel, along the handle, across both
_STIFFNESS, _DAMPING = 200.0, 2.0  # N/m and N s/m of the pad; the damping is critical
_COLOR, _PAD_COLOR = np.array([0.25, 0.26, 0.28, 1.0]), np.array([0.95, 0.45, 0.10, 1.0])


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
