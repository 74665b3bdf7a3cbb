"""Pick and place: lift a low block off the table and put it down at another place."""

import abc
import dataclasses as dc
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydrake.geometry import Box
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from geort_drake.hands.description import HandDescription
from geort_drake.people.human_hand import HumanHand
from geort_drake.simulation.operators.intention import ADAPTIVE, MIMICRY
from geort_drake.simulation.operators.perception import FreePlay
from geort_drake.simulation.operators.placing import PlacingPerson
from geort_drake.simulation.operators.simulated_operator import SimulatedOperator
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import SERVO, PerceivedPort, TrialResult
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner
from geort_drake.simulation.tasks.grasp.task import HANDLING, GraspStage, ObjectTask
from geort_drake.simulation.tasks.pick_place.monitor import Look, Progress, TransferMonitor, TransferOutcome
from geort_drake.simulation.view import add_view, shown_by
from geort_drake.simulation.world import add_scene
from geort_drake.systems.port_values import POSE_MIRROR

# Distance of the place from the middle of the object's placement, m; and ranges within which the place is
# drawn, m and rad.
_CARRY_DISTANCE, _POSITION_RANGE, _YAW_RANGE = 0.15, 0.02, 0.2
_MAX_ANGLE = math.radians(15)
_MARK = np.array([0.20, 0.62, 0.35, 1.0])


@dc.dataclass(frozen=True)
class TransferResult(TrialResult):
    """Result of one transfer. `outcome` is "success", or "lost" or "timeout" with the last step reached."""

    # Horizontal distance from the place, m, and signed angle from it about the vertical, rad, at the end.
    place_error: float
    place_turn: float
    # Step → when it was reached, s.
    step_times: dict[str, float]


class TransferTask(ObjectTask):
    """Grasp an object and bring it to its place.

    Attributes:
        heights: of the objects, m, by name.
        hover: height above its place from which the person lowers the object, m.
        hold_time: see `TransferMonitor`.
        steps: see `TransferMonitor`.
    """

    kinds = (ADAPTIVE, MIMICRY, SERVO)
    result = TransferResult
    heights: ClassVar[Mapping[str, float]]
    hover: float
    hold_time: float
    steps: ClassVar[Mapping[str, Progress]]

    def cases(self) -> list[str]:
        return list(self.heights)

    def keep(self, plans: Sequence[GraspGoal], play: FreePlay) -> tuple[GraspGoal, bool]:
        goal, is_attainable = super().keep(plans, play)
        return dc.replace(goal, play=play), is_attainable

    def place(self, scenario: Scenario, side: str, rng: np.random.Generator) -> RigidTransform:
        """X_WP of the scenario's object at its place, for a hand of that side."""
        x, y = scenario.object.position
        dx, dy = rng.uniform(-_POSITION_RANGE, _POSITION_RANGE, 2)
        yaw = rng.uniform(-_YAW_RANGE, _YAW_RANGE)
        z = scenario.object.support_height + self.heights[scenario.object.name] / 2
        way = _CARRY_DISTANCE if side == "left" else -_CARRY_DISTANCE
        return RigidTransform(RotationMatrix.MakeZRotation(yaw), [x + dx, y + way + dy, z])

    @abc.abstractmethod
    def add_place(self, plant: MultibodyPlant, X_WP: RigidTransform) -> None:
        """Adds what is at the place."""

    def add_stage(
        self,
        builder: DiagramBuilder,
        scenario: Scenario,
        description: HandDescription,
        goal: GraspGoal | None,
        X_WB: RigidTransform,
        rng: np.random.Generator,
    ) -> GraspStage:
        X_WP = self.place(scenario, description.side, rng.spawn(1)[0])
        scene = add_scene(builder, scenario, description, rng, lambda plant: self.add_place(plant, X_WP))
        view = add_view(builder, scene, description, scene.object_body)
        monitor = builder.AddNamedSystem(
            "transfer_monitor",
            TransferMonitor(
                len(description.fingers),
                X_WP,
                self.steps,
                self.hold_time,
                math.pi / 2,
                scene.object_shape.lowest_point,
                scenario.object.support_height,
            ),
        )
        for name in ("object_pose", "contact", "self_contact"):
            builder.Connect(view.GetOutputPort(name), monitor.GetInputPort(name))
        shown = shown_by(view, len(description.fingers), *HANDLING)
        return GraspStage(
            scene,
            monitor,
            {**shown, "place_pose": PerceivedPort(monitor.GetOutputPort("place_pose"), POSE_MIRROR)},
            {"step": (monitor.GetOutputPort("step"), ["reach", *self.steps])},
            [scene.object_body],
        )

    def person(
        self, scenario: Scenario, hand: HumanHand, goal: GraspGoal, X_WH_start: RigidTransform, seed: int
    ) -> LeafSystem:
        person = functools.partial(
            PlacingPerson, kind=scenario.kind, intention=scenario.intention, hover=self.hover
        )
        return SimulatedOperator(hand, goal, scenario.operator, X_WH_start, seed, person, has_place=True)

    def result_fields(self, outcome: TransferOutcome, description: HandDescription) -> dict[str, Any]:
        assert outcome.look is not None  # the monitor looks at the start
        reached = dict(zip(outcome.steps, outcome.times, strict=False))
        last = list(reached)[-1] if reached else "reach"
        ending = "lost" if outcome.lost else "timeout"
        return {
            "outcome": "success" if outcome.success else f"{ending}: {last}",
            "place_error": outcome.look.offset,
            "place_turn": outcome.look.turn,
            "step_times": {name: round(t, 6) for name, t in reached.items()},
        }


def _is_placed(look: Look) -> bool:
    return look.height < 0.003 and look.offset < 0.010 and max(abs(look.turn), look.tilt) < _MAX_ANGLE


class PickPlaceTask(TransferTask):
    """Lift a low block off the table and put it down at another place."""

    name = "pick_place"
    summary = "lift a low block off the table and put it down at another place"
    scenario = Path(__file__).with_name("scenario.yaml"), "PickPlace"
    heights: ClassVar[Mapping[str, float]] = {"block_20": 0.020, "block_25": 0.025, "block_30": 0.030}
    hover = 0.02
    hold_time = 0.5
    steps: ClassVar[Mapping[str, Progress]] = {
        "grasped": lambda look: look.touching >= 2,
        "lifted": lambda look: look.touching >= 2 and look.height > 0.08,
        "carried": lambda look: look.touching >= 2 and look.height > 0.003 and look.offset < 0.03,
        "placed": _is_placed,
        "released": lambda look: _is_placed(look) and look.touching == 0,
    }

    def plans(self, scenario: Scenario, description: HandDescription) -> list[GraspGoal]:
        # Above the middle, so that the block hangs, and at least 4 mm above the table.
        radius = max(finger.tip_radius for finger in description.fingers)
        tip_height = max(0.75 * self.heights[scenario.object.name], radius + 0.004)
        return GraspPlanner(scenario, description, "pinch", tip_height).plans()

    def add_place(self, plant: MultibodyPlant, X_WP: RigidTransform) -> None:
        """A mark, without contact."""
        p = X_WP.translation() * [1, 1, 0]
        X_WMark = RigidTransform(X_WP.rotation(), p)
        plant.RegisterVisualGeometry(plant.world_body(), X_WMark, Box(0.03, 0.03, 0.0008), "place", _MARK)


TASK = PickPlaceTask()
