"""Base class of tasks that bring an object to a place, in steps."""

import abc
import dataclasses as dc
import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder

from geort_drake.hands.description import HandDescription
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.simulation.monitor import Outcome, TaskMonitor
from geort_drake.simulation.operators.intention import ADAPTIVE, MIMICRY, SERVO
from geort_drake.simulation.operators.placing import PlacingPerson
from geort_drake.simulation.operators.simulated_operator import Person
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import Stage, TrialResult
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.task import HANDLING, ObjectTask
from geort_drake.simulation.view import add_monitor, add_view, shown_by
from geort_drake.simulation.world import add_scene
from geort_drake.systems.port_values import pose_to_vector, vector_to_pose

TOUCH_FORCE = 0.02  # N, force above which a finger touches
HOLD_TIME = 0.5  # s for which the last step must stay done
# The object is lost if it is this far below its place, or this far from it and untouched, m.
_MAX_FALL, _MAX_OFFSET = 0.025, 0.4


class CarriedState(NamedTuple):
    """An object relative to its place; lengths in m, angles in rad."""

    height: float  # height of its lowest point above where that belongs
    offset: float  # horizontal distance
    turn: float  # angle about the vertical, modulo the quarter turns of a square
    tilt: float  # angle of its z axis from the vertical
    touching: int  # number of fingers that touch it


# Name of a step → whether it is done; a step counts only after those before it.
Steps = Mapping[str, Callable[[CarriedState], bool]]


@dc.dataclass(frozen=True)
class TransferOutcome(Outcome):
    """The steps so far; times in s since the start."""

    # Number of steps of the task.
    num_steps: int
    # When each step was reached, in order.
    times: tuple[float, ...] = ()
    # Since when the last step has been done; NaN while it is not.
    done_since: float = math.nan
    carried: CarriedState | None = None
    lost: bool = False

    @property
    def success(self) -> bool:
        """Whether all steps were reached."""
        return len(self.times) == self.num_steps

    @property
    def over(self) -> bool:
        """Whether the transfer is decided."""
        return self.success or self.lost

    @property
    def score(self) -> float:
        """Fraction of the steps that were reached, one after another."""
        return len(self.times) / self.num_steps

    @property
    def completion_time(self) -> float:
        """Time from the start until the last step was done, s; NaN without success."""
        return self.times[-1] if self.success else math.nan


class TransferMonitor(TaskMonitor[TransferOutcome]):
    """Judges the transfer of an object, without delay or noise, and terminates a decided simulation.

    Input ports, besides those of `TaskMonitor`:
        object_pose (7): X_WO, qw qx qy qz x y z.
    Output ports:
        place_pose (7): X_WP, where the object belongs, qw qx qy qz x y z.
        step (1): number of steps reached.
        outcome (abstract TransferOutcome).

    Args:
        steps: the steps, in order.
        X_WP: pose at which the object belongs.
        lowest_point: maps X_WO to the height in W of the object's lowest point, m.
    """

    def __init__(
        self,
        num_fingers: int,
        steps: Steps,
        X_WP: RigidTransform,
        lowest_point: Callable[[RigidTransform], float],
    ):
        super().__init__(num_fingers, TransferOutcome(len(steps)))
        self._steps, self._X_WP = list(steps.values()), X_WP
        self._lowest_point, self._ground = lowest_point, lowest_point(X_WP)
        self._object_pose = self.DeclareVectorInputPort("object_pose", 7)
        place = pose_to_vector(X_WP)
        self._declare_output("place_pose", 7, lambda outcome: place)
        self._declare_output("step", 1, lambda outcome: len(outcome.times))

    def _seen(self, context: Context) -> CarriedState:
        X_WO = vector_to_pose(self._object_pose.Eval(context))
        offset = X_WO.translation() - self._X_WP.translation()
        R = self._X_WP.rotation().matrix().T @ X_WO.rotation().matrix()
        turn = math.remainder(math.atan2(R[1, 0], R[0, 0]), math.pi / 2)
        return CarriedState(
            height=self._lowest_point(X_WO) - self._ground,
            offset=math.hypot(*offset[:2]),
            turn=turn,
            tilt=math.acos(min(max(X_WO.rotation().matrix()[2, 2], -1.0), 1.0)),
            touching=int(np.sum(self._contact.Eval(context) > TOUCH_FORCE)),
        )

    def _judged(self, context: Context, before: TransferOutcome) -> TransferOutcome:
        t, carried = before.t, self._seen(context)
        times, done_since = before.times, math.nan
        if self._steps[len(times)](carried):
            if len(times) < len(self._steps) - 1:
                times = (*times, t)
            else:
                done_since = t if math.isnan(before.done_since) else before.done_since
                if t - done_since > HOLD_TIME - 1e-9:
                    times = (*times, done_since)
        return before.having(
            times=times,
            done_since=done_since,
            carried=carried,
            lost=carried.height < -_MAX_FALL or (carried.offset > _MAX_OFFSET and carried.touching == 0),
        )


@dc.dataclass(frozen=True)
class TransferResult(TrialResult):
    """Result of one transfer. `outcome` is "success", or "lost" or "timeout" with the last step reached."""

    # Final horizontal distance from the place, m, and signed angle about the vertical, rad.
    place_error: float
    place_turn: float
    # Step → time at which it was reached, s.
    step_times: dict[str, float]


class TransferTask(ObjectTask):
    """Bring an object to its place.

    Attributes:
        steps: the steps, in order.
        hover: height above its place from which the person lowers the object, m.
        upright: whether the person turns the object upright; otherwise, its tilt is left to gravity.
    """

    kinds = (ADAPTIVE, MIMICRY, SERVO)
    result = TransferResult
    steps: ClassVar[Steps]
    hover: float
    upright: bool

    @abc.abstractmethod
    def place(self, scenario: Scenario, side: str, rng: np.random.Generator) -> RigidTransform:
        """Returns X_WP, where the scenario's object belongs, for a hand of that side; `rng` draws it."""

    def add_fixtures(self, plant: MultibodyPlant, X_WP: RigidTransform) -> None:
        """Adds geometry that depends on the place."""

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
        scene = add_scene(builder, scenario, description, rng, lambda plant: self.add_fixtures(plant, X_WP))
        view = add_view(builder, scene, description, scene.object_body)
        lowest_point = scene.object_shape.lowest_point
        monitor = TransferMonitor(len(description.fingers), self.steps, X_WP, lowest_point)
        add_monitor(builder, "transfer_monitor", monitor, view)
        return Stage(
            scene,
            monitor,
            shown_by(view, monitor, (*HANDLING, "place_pose")),
            {"step": (monitor.GetOutputPort("step"), ["reach", *self.steps])},
            [scene.object_body],
        )

    def person(
        self, scenario: Scenario, hand: HumanHand, goal: GraspGoal, rng: np.random.Generator
    ) -> Person:
        known = hand, goal, scenario.operator, rng, scenario.kind, scenario.intention
        return PlacingPerson(*known, hover=self.hover, upright=self.upright)

    def result_fields(self, outcome: TransferOutcome, description: HandDescription) -> dict[str, Any]:
        assert outcome.carried is not None  # the monitor's first check is at the start
        reached = dict(zip(self.steps, outcome.times, strict=False))
        last = list(reached)[-1] if reached else "reach"
        ending = "lost" if outcome.lost else "timeout"
        return {
            "outcome": "success" if outcome.success else f"{ending}: {last}",
            "place_error": outcome.carried.offset,
            "place_turn": outcome.carried.turn,
            "step_times": {name: round(t, 6) for name, t in reached.items()},
        }
