"""Pick and place: lift a low block off the table and put it down at another place."""

import dataclasses as dc
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydrake.geometry import Box
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder

from geort_drake.hands.description import HandDescription
from geort_drake.people.human_hand import HumanHand
from geort_drake.simulation.monitor import Outcome, TaskMonitor
from geort_drake.simulation.operators.intention import ADAPTIVE, MIMICRY, SERVO
from geort_drake.simulation.operators.placing import PlacingPerson
from geort_drake.simulation.operators.simulated_operator import Person
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import Stage, TrialResult
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner
from geort_drake.simulation.tasks.grasp.task import HANDLING, ObjectTask
from geort_drake.simulation.view import add_monitor, add_view, shown_by
from geort_drake.simulation.world import add_scene
from geort_drake.systems.port_values import pose_to_vector, vector_to_pose

TOUCH_FORCE = 0.02  # N, force above which a finger touches
HOLD_TIME = 0.5  # s for which the last step must stay done
# The block is lost if it is this far below its support, or this far from its place and untouched, m.
_MAX_FALL, _MAX_OFFSET = 0.03, 0.4
_MAX_ANGLE = math.radians(15)
# Distance of the place from the middle of the object's initial position, m; and ranges within which the place
# is drawn, m and rad.
_CARRY_DISTANCE, _POSITION_RANGE, _YAW_RANGE = 0.15, 0.02, 0.2
_MARK = np.array([0.20, 0.62, 0.35, 1.0])


class BlockState(NamedTuple):
    """A block relative to its support and its place; lengths in m, angles in rad."""

    height: float  # height of its lowest point above the support
    offset: float  # horizontal distance from its place
    turn: float  # angle about the vertical from its place, modulo the quarter turns of a square
    tilt: float  # angle of its z axis from the vertical
    touching: int  # number of fingers that touch it


def _is_placed(block: BlockState) -> bool:
    return block.height < 0.003 and block.offset < 0.010 and max(abs(block.turn), block.tilt) < _MAX_ANGLE


# Name of a step → whether it is done; a step counts only after those before it.
STEPS: dict[str, Callable[[BlockState], bool]] = {
    "grasped": lambda block: block.touching >= 2,
    "lifted": lambda block: block.touching >= 2 and block.height > 0.08,
    "carried": lambda block: block.touching >= 2 and block.height > 0.003 and block.offset < 0.03,
    "placed": _is_placed,
    "released": lambda block: _is_placed(block) and block.touching == 0,
}


@dc.dataclass(frozen=True)
class TransferOutcome(Outcome):
    """The steps so far; times in s since the start."""

    # When each step was reached, in order.
    times: tuple[float, ...] = ()
    # Since when the last step has been done; NaN while it is not.
    done_since: float = math.nan
    block: BlockState | None = None
    lost: bool = False

    @property
    def success(self) -> bool:
        """Whether all steps were reached."""
        return len(self.times) == len(STEPS)

    @property
    def over(self) -> bool:
        """Whether the transfer is decided."""
        return self.success or self.lost

    @property
    def score(self) -> float:
        """Fraction of the steps that were reached, one after another."""
        return len(self.times) / len(STEPS)

    @property
    def completion_time(self) -> float:
        """Time from the start until the last step was done, s; NaN without success."""
        return self.times[-1] if self.success else math.nan


class TransferMonitor(TaskMonitor[TransferOutcome]):
    """Judges the transfer of a block, without delay or noise, and terminates a decided simulation.

    Input ports, besides those of `TaskMonitor`:
        object_pose (7): X_WO, qw qx qy qz x y z.
    Output ports:
        place_pose (7): X_WP, where the block belongs, qw qx qy qz x y z.
        step (1): number of steps reached.
        outcome (abstract TransferOutcome).

    Args:
        X_WP: pose at which the block belongs.
        lowest_point: maps X_WO to the height in W of the block's lowest point, m.
        support_height: height of the support in W, m.
    """

    def __init__(
        self,
        num_fingers: int,
        X_WP: RigidTransform,
        lowest_point: Callable[[RigidTransform], float],
        support_height: float,
    ):
        super().__init__(num_fingers, TransferOutcome())
        self._X_WP, self._lowest_point, self._support = X_WP, lowest_point, support_height
        self._object_pose = self.DeclareVectorInputPort("object_pose", 7)
        place = pose_to_vector(X_WP)
        self._declare_output("place_pose", 7, lambda outcome: place)
        self._declare_output("step", 1, lambda outcome: len(outcome.times))

    def _seen(self, context: Context) -> BlockState:
        X_WO = vector_to_pose(self._object_pose.Eval(context))
        offset = X_WO.translation() - self._X_WP.translation()
        R = self._X_WP.rotation().matrix().T @ X_WO.rotation().matrix()
        turn = math.remainder(math.atan2(R[1, 0], R[0, 0]), math.pi / 2)
        return BlockState(
            height=self._lowest_point(X_WO) - self._support,
            offset=math.hypot(*offset[:2]),
            turn=turn,
            tilt=math.acos(min(max(X_WO.rotation().matrix()[2, 2], -1.0), 1.0)),
            touching=int(np.sum(self._contact.Eval(context) > TOUCH_FORCE)),
        )

    def _judged(self, context: Context, before: TransferOutcome) -> TransferOutcome:
        t, block = before.t, self._seen(context)
        times, done_since = before.times, math.nan
        if list(STEPS.values())[len(times)](block):
            if len(times) < len(STEPS) - 1:
                times = (*times, t)
            else:
                done_since = t if math.isnan(before.done_since) else before.done_since
                if t - done_since > HOLD_TIME - 1e-9:
                    times = (*times, done_since)
        return before.having(
            times=times,
            done_since=done_since,
            block=block,
            lost=block.height < -_MAX_FALL or (block.offset > _MAX_OFFSET and block.touching == 0),
        )


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
        return PlacingPerson(hand, goal, scenario.operator, rng, scenario.kind, scenario.intention)

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
