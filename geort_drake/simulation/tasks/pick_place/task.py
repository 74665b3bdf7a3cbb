"""Pick and place: lift a low block off the table and put it down at another place."""

import dataclasses as dc
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydrake.geometry import Box
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from geort_drake.hands.description import HandDescription
from geort_drake.people.human_hand import HumanHand
from geort_drake.simulation.operators.intention import ADAPTIVE, MIMICRY, SERVO
from geort_drake.simulation.operators.placing import PlacingPerson
from geort_drake.simulation.operators.simulated_operator import Person
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import Stage, TrialResult
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner
from geort_drake.simulation.tasks.grasp.task import HANDLING, ObjectTask
from geort_drake.simulation.tasks.pick_place.monitor import STEPS, TransferMonitor, TransferOutcome
from geort_drake.simulation.view import add_monitor, add_view, shown_by
from geort_drake.simulation.world import add_scene

# Distance of the place from the middle of the object's initial position, m; and ranges within which the place
# is drawn, m and rad.
_CARRY_DISTANCE, _POSITION_RANGE, _YAW_RANGE = 0.15, 0.02, 0.2
HOVER = 0.02  # m, height above the place from which the person lowers the block
_MARK = np.array([0.20, 0.62, 0.35, 1.0])


@dc.dataclass(frozen=True)
class TransferResult(TrialResult):
    """Result of one transfer. `outcome` is "success", or "lost" or "timeout" with the last step reached."""

    # Final horizontal distance from the place, m, and signed angle about the vertical, rad.
    place_error: float
    place_turn: float
    # Step → time at which it was reached, s.
    step_times: dict[str, float]


class PickPlaceTask(ObjectTask):
    """Lift a low block off the table and put it down at another place."""

    name = "pick_place"
    summary = "lift a low block off the table and put it down at another place"
    scenario = Path(__file__).with_name("scenario.yaml"), "PickPlace"
    kinds = (ADAPTIVE, MIMICRY, SERVO)
    result = TransferResult
    heights: ClassVar[Mapping[str, float]] = {"block_20": 0.020, "block_25": 0.025, "block_30": 0.030}  # m

    def cases(self) -> list[str]:
        return list(self.heights)

    def place(self, scenario: Scenario, side: str, rng: np.random.Generator) -> RigidTransform:
        """Returns X_WP, where the scenario's object belongs, for a hand of that side; `rng` draws it."""
        x, y = scenario.object.position
        dx, dy = rng.uniform(-_POSITION_RANGE, _POSITION_RANGE, 2)
        yaw = rng.uniform(-_YAW_RANGE, _YAW_RANGE)
        z = scenario.object.support_height + self.heights[scenario.object.name] / 2
        carry = _CARRY_DISTANCE if side == "left" else -_CARRY_DISTANCE
        return RigidTransform(RotationMatrix.MakeZRotation(yaw), [x + dx, y + carry + dy, z])

    def plans(self, scenario: Scenario, description: HandDescription) -> list[GraspGoal]:
        # Above the middle, so that the block hangs, and with at least 4 mm between tips and table.
        radius = max(finger.tip_radius for finger in description.fingers)
        tip_height = max(0.75 * self.heights[scenario.object.name], radius + 0.004)
        return GraspPlanner(scenario, description, "pinch", tip_height).plans()

    def add_stage(
        self,
        builder: DiagramBuilder,
        scenario: Scenario,
        description: HandDescription,
        goal: GraspGoal | None,
        X_WB: RigidTransform,
        rng: np.random.Generator,
    ) -> Stage:
        X_WP = self.place(scenario, description.side, rng.spawn(1)[0])
        scene = add_scene(builder, scenario, description, rng, lambda plant: _add_mark(plant, X_WP))
        view = add_view(builder, scene, description, scene.object_body)
        lowest_point, support = scene.object_shape.lowest_point, scenario.object.support_height
        monitor = TransferMonitor(len(description.fingers), X_WP, lowest_point, support)
        add_monitor(builder, "transfer_monitor", monitor, view)
        return Stage(
            scene,
            monitor,
            shown_by(view, monitor, (*HANDLING, "place_pose")),
            {"step": (monitor.GetOutputPort("step"), ["reach", *STEPS])},
            [scene.object_body],
        )

    def person(
        self, scenario: Scenario, hand: HumanHand, goal: GraspGoal, rng: np.random.Generator
    ) -> Person:
        config, intention = scenario.operator, scenario.intention
        return PlacingPerson(hand, goal, config, rng, scenario.kind, intention, HOVER)

    def result_fields(self, outcome: TransferOutcome, description: HandDescription) -> dict[str, Any]:
        assert outcome.block is not None  # the monitor's first check is at the start
        reached = dict(zip(STEPS, outcome.times, strict=False))
        last = list(reached)[-1] if reached else "reach"
        ending = "lost" if outcome.lost else "timeout"
        return {
            "outcome": "success" if outcome.success else f"{ending}: {last}",
            "place_error": outcome.block.offset,
            "place_turn": outcome.block.turn,
            "step_times": {name: round(t, 6) for name, t in reached.items()},
        }


def _add_mark(plant: MultibodyPlant, X_WP: RigidTransform) -> None:
    """Draws a mark at the place; it has no collision geometry."""
    X_WMark = RigidTransform(X_WP.rotation(), X_WP.translation() * [1, 1, 0])
    plant.RegisterVisualGeometry(plant.world_body(), X_WMark, Box(0.03, 0.03, 0.0008), "place", _MARK)


TASK = PickPlaceTask()
