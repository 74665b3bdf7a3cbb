"""The keys: press the cued one of three without moving the others, with a parked hand."""

import dataclasses as dc
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Box
from pydrake.math import RigidTransform
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
from geort_drake.simulation.operators.key_presser import KeyPresser
from geort_drake.simulation.task import Signals, States, TrialResult
from geort_drake.simulation.tasks.keys.goal import CAP_LENGTH, CAP_WIDTH, KeysGoal
from geort_drake.simulation.tasks.keys.monitor import KeysMonitor, KeysOutcome, KeysSettings
from geort_drake.simulation.tasks.keys.planner import TRAVEL, KeysPlanner

_CAP_HEIGHT, _CAP_MASS = 0.006, 0.005  # m, kg
_STIFFNESS, _DAMPING = 150.0, 1.7  # N/m and N s/m of a key; the damping is critical
_FRICTION = CoulombFriction(0.6, 0.6)
_COLOR, _BED_COLOR = np.array([0.93, 0.93, 0.90, 1.0]), np.array([0.25, 0.26, 0.28, 1.0])


@dc.dataclass(frozen=True)
class KeysResult(TrialResult):
    """Result of one trial of keys. `outcome` is "success", or the number of each fault."""

    # Presses in which the cued key went down, and in which the others stayed still.
    pressed: int
    still: int
    # Means over the presses: largest travel of another key, m; and time until the cued key was down, s; None
    # if none was.
    others_travel: float
    press_time: float | None


class KeysTask(FingerTask[KeysGoal]):
    """Press the cued one of three keys without moving the others."""

    name = "keys"
    summary = "press the cued one of three keys without moving the others"
    result = KeysResult
    scenario = Path(__file__).with_name("scenario.yaml"), "Keys"
    settings = KeysSettings
    planner = KeysPlanner
    person_type = KeyPresser
    percepts = ("travel", "cue")

    def add_handled(
        self, plant: MultibodyPlant, goal: KeysGoal, X_WB: RigidTransform, rng: np.random.Generator
    ) -> Handled:
        """Adds key caps on springs above a bed; they are pressed along +x of B."""
        model = plant.AddModelInstance("keys")
        bed = plant.AddRigidBody("bed", model, SpatialInertia.SolidBoxWithMass(0.5, 0.006, 0.15, 0.06))
        depth = _CAP_HEIGHT + TRAVEL + 0.004  # from the caps' tops to the middle of the bed
        X_WBed = X_WB @ RigidTransform(goal.p_BK.mean(axis=0) + [depth, 0, 0])
        plant.WeldFrames(plant.world_frame(), bed.body_frame(), X_WBed)
        plant.RegisterVisualGeometry(bed, RigidTransform(), Box(0.006, 0.15, 0.06), "bed", _BED_COLOR)
        caps, joints = [], []
        shape = Box(_CAP_HEIGHT, CAP_WIDTH, CAP_LENGTH)
        for number, p in enumerate(goal.p_BK):
            inertia = SpatialInertia.SolidBoxWithMass(_CAP_MASS, _CAP_HEIGHT, CAP_WIDTH, CAP_LENGTH)
            cap = plant.AddRigidBody(f"cap_{number + 1}", model, inertia)
            X_WCap = X_WB @ RigidTransform(p + [_CAP_HEIGHT / 2, 0, 0])
            joint = plant.AddJoint(
                PrismaticJoint(
                    f"key_{number + 1}",
                    plant.AddFrame(FixedOffsetFrame(f"rest_{number + 1}", bed, X_WBed.inverse() @ X_WCap)),
                    cap.body_frame(),
                    [1.0, 0.0, 0.0],
                    0.0,
                    TRAVEL,
                    _DAMPING,
                )
            )
            plant.AddForceElement(PrismaticSpring(joint, 0.0, _STIFFNESS))
            plant.RegisterCollisionGeometry(cap, RigidTransform(), shape, "cap", _FRICTION)
            plant.RegisterVisualGeometry(cap, RigidTransform(), shape, "cap", _COLOR)
            caps.append(cap)
            joints.append(joint)
        return Handled(bed, caps, joints)

    def make_monitor(
        self,
        num_fingers: int,
        goal: KeysGoal,
        X_WB: RigidTransform,
        settings: KeysSettings,
        rng: np.random.Generator,
    ) -> KeysMonitor:
        # Cues every key equally often.
        cued = rng.permutation(np.arange(round(settings.presses)) % len(goal.p_BK))
        return KeysMonitor(len(goal.p_BK), num_fingers, cued.tolist(), settings)

    def recorded(self, monitor: TaskMonitor, settings: KeysSettings) -> tuple[States, Signals]:
        cue, travel = monitor.GetOutputPort("cue"), monitor.GetOutputPort("travel")
        names = [f"key {number + 1}" for number in range(travel.size())]
        return {"cue": (cue, ["none", *names])}, {"keys/travel": (travel, names, "m")}

    def result_fields(self, outcome: KeysOutcome, description: HandDescription) -> dict[str, Any]:
        settings, presses = outcome.settings, outcome.presses
        pressed = sum(press.depth > settings.depth for press in presses)
        still = sum(press.others < settings.still for press in presses)
        times = [press.time for press in presses if press.depth > settings.depth]
        if outcome.success:
            text = "success"
        else:
            text = f"{len(presses) - pressed} not pressed, {len(presses) - still} with others"
        return {
            "outcome": text,
            "pressed": pressed,
            "still": still,
            "others_travel": float(np.mean([press.others for press in presses])) if presses else 0.0,
            "press_time": float(np.mean(times)) if times else None,
        }


TASK = KeysTask()
