"""The grasp: lift an object and hold it."""

import dataclasses as dc
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import UnknownNameError
from geort_drake.files import finite_json
from geort_drake.hands.description import HandDescription
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.resources import diagrams_dir, object_names
from geort_drake.simulation.operators.behavior import GraspingPerson
from geort_drake.simulation.operators.intending import IntendingPerson
from geort_drake.simulation.operators.intention import ADAPTIVE, MIMICRY, SERVO
from geort_drake.simulation.operators.simulated_operator import Person
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import Stage, Task, TrialResult
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.monitor import GraspMonitor, GraspOutcome, GraspPhase
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner
from geort_drake.simulation.view import add_monitor, add_view, shown_by
from geort_drake.simulation.world import add_scene

# Ports that a person who handles an object perceives.
HANDLING = ("fingertips", "hand_pose", "object_pose", "contact")


@dc.dataclass(frozen=True)
class GraspResult(TrialResult):
    """Result of one grasp; times in simulated s.

    `outcome` is "success"; "timeout: PHASE" with the monitor's last phase; or "thrown: PHASE" with the last
    phase in which a finger touched the object, or reach if none did, as when the palm knocked it over.
    """

    # Whether it succeeded and only fingertip links touched the object during the hold.
    tip_success: bool
    # Link of the hand → time for which it touched the object during the hold.
    holding: dict[str, float]
    # Phase of the monitor → time of its first entry, and total time spent in it.
    phase_times: dict[str, float]
    phase_durations: dict[str, float]
    # Number of lifts that ended in a drop, see `GraspOutcome`.
    drops: int
    # Largest displacement of the object in the hand during the last lift, m; None without a lift.
    slip: float | None
    peak_height: float


class ObjectTask(Task[GraspGoal]):
    """Base class of tasks that begin with the grasp of an object; the object is the case."""

    def choose(self, scenario: Scenario, case: str) -> None:
        if case not in self.cases():
            raise UnknownNameError("object", case, self.cases())
        scenario.object.name = case

    def case_of(self, scenario: Scenario) -> str:
        return scenario.object.name


class GraspTask(ObjectTask):
    """Lift an object and hold it."""

    name = "grasp"
    summary = "lift an object and hold it"
    begins_after_play = False
    kinds = (SERVO, ADAPTIVE, MIMICRY)
    result = GraspResult
    scenario = diagrams_dir() / "grasp.scenarios.yaml", "Grasp"

    def cases(self) -> list[str]:
        return object_names()

    def plans(self, scenario: Scenario, description: HandDescription) -> list[GraspGoal]:
        return GraspPlanner(scenario, description).plans()

    def add_stage(
        self,
        builder: DiagramBuilder,
        scenario: Scenario,
        description: HandDescription,
        goal: GraspGoal | None,
        X_WB: RigidTransform,
        rng: np.random.Generator,
    ) -> Stage:
        scene = add_scene(builder, scenario, description, rng)
        view = add_view(builder, scene, description, scene.object_body)
        lowest_point, support = scene.object_shape.lowest_point, scenario.object.support_height
        num_fingers = len(description.fingers)
        monitor = GraspMonitor(num_fingers, view.links, lowest_point, support, scenario.monitor)
        add_monitor(builder, "grasp_monitor", monitor, view)
        phases = [phase.name.lower() for phase in GraspPhase]
        return Stage(
            scene,
            monitor,
            shown_by(view, monitor, HANDLING),
            {"grasp": (monitor.GetOutputPort("phase"), phases)},
            [scene.object_body],
        )

    def person(
        self, scenario: Scenario, hand: HumanHand, goal: GraspGoal, rng: np.random.Generator
    ) -> Person:
        if scenario.kind == SERVO:
            return GraspingPerson(hand, goal, scenario.operator, rng)
        return IntendingPerson(hand, goal, scenario.operator, rng, scenario.kind, scenario.intention)

    def result_fields(self, outcome: GraspOutcome, description: HandDescription) -> dict[str, Any]:
        if outcome.success:
            text = "success"
        elif outcome.phase == GraspPhase.THROWN:
            text = f"thrown: {outcome.last_touched.name.lower()}"
        else:
            text = f"timeout: {outcome.phase.name.lower()}"
        tip_links = {finger.tip_link for finger in description.fingers}
        return {
            "outcome": text,
            "tip_success": outcome.success and outcome.holding.keys() <= tip_links,
            "holding": {link: round(spent, 6) for link, spent in outcome.holding.items()},
            "phase_times": outcome.times,
            "phase_durations": {name: round(spent, 6) for name, spent in outcome.durations.items()},
            "drops": outcome.drops,
            "slip": finite_json(outcome.slip),
            "peak_height": outcome.peak_height,
        }


TASK = GraspTask()
