"""The keys: press the cued one of three, the others still, with a parked hand."""

import dataclasses as dc
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    ModelInstanceIndex,
    PrismaticJoint,
    PrismaticSpring,
    RigidBody,
    SpatialInertia,
)
from pydrake.systems.framework import DiagramBuilder

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_task import FingerTask
from geort_drake.simulation.operators.key_presser import KeyPresser
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import PerceivedPort, Stage, TrialResult
from geort_drake.simulation.tasks.keys.goal import CAP_LENGTH, CAP_WIDTH, KeysGoal
from geort_drake.simulation.tasks.keys.monitor import KeysMonitor, KeysOutcome, KeysSettings
from geort_drake.simulation.tasks.keys.planner import TRAVEL, KeysPlanner
from geort_drake.simulation.view import add_view, shown_by
from geort_drake.simulation.world import add_robot, finish_scene

_CAP_HEIGHT, _CAP_MASS = 0.006, 0.005  # m, kg
_STIFFNESS, _DAMPING = 150.0, 1.7  # N/m and N s/m of a key; the damping is critical
_FRICTION = CoulombFriction(0.6, 0.6)
_COLOR, _BED_COLOR = np.array([0.93, 0.93, 0.90, 1.0]), np.array([0.25, 0.26, 0.28, 1.0])


@dc.dataclass(frozen=True)
class KeysResult(TrialResult):
    """Result of one trial of keys. `outcome` is "success", or the numbers of faults."""

    # Presses in which the cued key went down, and in which the others stayed still.
    pressed: int
    still: int
    # Means over the presses: largest travel of another key, m; and time until the cued key was down, s, None
    # if none was.
    others_travel: float
    press_time: float | None


class KeysTask(FingerTask[KeysGoal]):
    """Press the cued one of three keys; the others stay still."""

    name = "keys"
    summary = "press the cued one of three keys, the others still"
    result = KeysResult
    scenario = Path(__file__).with_name("scenario.yaml"), "Keys"
    settings = KeysSettings
    planner = KeysPlanner
    person_type = KeyPresser

    def places(self, goal: KeysGoal) -> Sequence[np.ndarray]:
        return goal.p_BF_open, goal.p_BF_pressed

    def percepts(self, goal: KeysGoal) -> dict[str, int]:
        return {"travel": len(goal.p_BK), "cue": 1}

    def add_stage(
        self,
        builder: DiagramBuilder,
        scenario: Scenario,
        description: HandDescription,
        goal: KeysGoal | None,
        X_WB: RigidTransform,
        rng: np.random.Generator,
    ) -> Stage:
        goal = goal or self.plans(scenario, description)[0]
        settings = KeysSettings(**scenario.task_settings)
        plant, scene_graph = AddMultibodyPlant(scenario.plant_config, builder)
        add_robot(plant, scenario, description)
        keys, bed, caps = _add_keys(plant, X_WB, goal.p_BK)
        scene = finish_scene(plant, scene_graph, scenario, description)
        view = add_view(builder, scene, description, bed, caps)
        # Every key equally often.
        presses = round(settings.presses)
        cued = rng.permutation(np.arange(presses) % len(caps))
        monitor = builder.AddNamedSystem(
            "keys_monitor", KeysMonitor(len(caps), len(description.fingers), cued.tolist(), settings)
        )
        builder.Connect(plant.get_state_output_port(keys), monitor.GetInputPort("keys"))
        for name in ("contact", "self_contact"):
            builder.Connect(view.GetOutputPort(name), monitor.GetInputPort(name))
        shown = {
            **shown_by(view, len(description.fingers), "fingertips", "hand_pose"),
            "travel": PerceivedPort(monitor.GetOutputPort("travel")),
            "cue": PerceivedPort(monitor.GetOutputPort("cue")),
        }
        names = [f"key {number + 1}" for number in range(len(caps))]
        return Stage(
            scene,
            monitor,
            shown,
            {"cue": (monitor.GetOutputPort("cue"), ["none", *names])},
            signals={"keys/travel": (monitor.GetOutputPort("travel"), names, "m")},
        )

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


def _add_keys(
    plant: MultibodyPlant, X_WB: RigidTransform, p_BK: np.ndarray
) -> tuple[ModelInstanceIndex, RigidBody, list[RigidBody]]:
    """Adds caps on springs that are pressed along +x of B, above a bed; returns model, bed and caps."""
    model = plant.AddModelInstance("keys")
    bed = plant.AddRigidBody("bed", model, SpatialInertia.SolidBoxWithMass(0.5, 0.006, 0.15, 0.06))
    depth = _CAP_HEIGHT + TRAVEL + 0.004  # from the caps' tops to the middle of the bed
    X_WBed = X_WB @ RigidTransform(p_BK.mean(axis=0) + [depth, 0, 0])
    plant.WeldFrames(plant.world_frame(), bed.body_frame(), X_WBed)
    plant.RegisterVisualGeometry(bed, RigidTransform(), Box(0.006, 0.15, 0.06), "bed", _BED_COLOR)
    caps = []
    shape = Box(_CAP_HEIGHT, CAP_WIDTH, CAP_LENGTH)
    for number, p in enumerate(p_BK):
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
    return model, bed, caps


TASK = KeysTask()
