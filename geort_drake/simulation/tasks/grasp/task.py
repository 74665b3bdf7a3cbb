"""The grasp: lift an object and hold it."""

import dataclasses as dc
from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem

from geort_drake.errors import UnknownNameError
from geort_drake.hands.description import HandDescription
from geort_drake.people.human_hand import HumanHand
from geort_drake.resources import diagrams_dir
from geort_drake.simulation.free_play import keep_attainable
from geort_drake.simulation.operators.perception import FreePlay
from geort_drake.simulation.operators.simulated_operator import SimulatedOperator
from geort_drake.simulation.scenario import Scenario, object_names
from geort_drake.simulation.task import SERVO, Stage, Task, TrialResult, finite_or_none
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.monitor import GraspMonitor, GraspOutcome, GraspPhase
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner
from geort_drake.simulation.view import add_view, shown_by
from geort_drake.simulation.world import ObjectScene, add_scene
from geort_drake.systems.scene_view import SceneView

# What the person sees and feels who handles an object.
HANDLING = ("fingertips", "hand_pose", "object_pose", "contact")


@dc.dataclass(frozen=True)
class GraspResult(TrialResult):
    """Result of one grasp; times in simulated s.

    `outcome` is "success"; "timeout: PHASE" with the monitor's last phase; or "thrown: PHASE" with the last
    phase in which a finger touched the object, or reach if none did, as when the palm knocked it over.
    """

    # Whether it succeeded and only links of fingertips touched the object during the hold.
    tip_success: bool
    # Time in which each link of the hand touched the object during the hold.
    holding: dict[str, float]
    # By phase of the monitor: first entry, and total time.
    phase_times: dict[str, float]
    phase_durations: dict[str, float]
    # Number of lifts that ended in a drop, see `GraspOutcome`.
    drops: int
    # Largest displacement of the object in the hand during the last lift, m; None without a lift.
    slip: float | None
    peak_height: float


@dc.dataclass(frozen=True)
class GraspStage(Stage):
    """The stage of a grasp."""

    scene: ObjectScene

    def initialize(self, root: Context) -> None:
        """Sets the object's mass."""
        context = self.scene.plant.GetMyMutableContextFromRoot(root)
        body, factor = self.scene.object_body, self.scene.placement.mass_factor
        M = body.CalcSpatialInertiaInBodyFrame(context)
        scaled = SpatialInertia(factor * M.get_mass(), M.get_com(), M.get_unit_inertia())
        body.SetSpatialInertiaInBodyFrame(context, scaled)


class ObjectTask(Task[GraspGoal]):
    """A task that begins with the grasp of an object, which is its case."""

    def choose(self, scenario: Scenario, case: str) -> None:
        if case not in self.cases():
            raise UnknownNameError("object", case, self.cases())
        scenario.object.name = case

    def case_of(self, scenario: Scenario) -> str:
        return scenario.object.name

    def keep(self, plans: Sequence[GraspGoal], play: FreePlay) -> tuple[GraspGoal, bool]:
        return keep_attainable(plans, play.p_BF)


class GraspTask(ObjectTask):
    """Lift an object and hold it."""

    name = "grasp"
    summary = "lift an object and hold it"
    begins_after_play = False
    kinds = (SERVO,)
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
    ) -> GraspStage:
        scene = add_scene(builder, scenario, description, rng)
        view, monitor = add_monitor(builder, scene, scenario, description)
        phases = [phase.name.lower() for phase in GraspPhase]
        return GraspStage(
            scene,
            monitor,
            shown_by(view, len(description.fingers), *HANDLING),
            {"grasp": (monitor.GetOutputPort("phase"), phases)},
            [scene.object_body],
        )

    def person(
        self, scenario: Scenario, hand: HumanHand, goal: GraspGoal, X_WH_start: RigidTransform, seed: int
    ) -> LeafSystem:
        return SimulatedOperator(hand, goal, scenario.operator, X_WH_start, seed)

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
            "slip": finite_or_none(outcome.slip),
            "peak_height": outcome.peak_height,
        }


def add_monitor(
    builder: DiagramBuilder, scene: ObjectScene, scenario: Scenario, description: HandDescription
) -> tuple[SceneView, GraspMonitor]:
    """Adds the systems that observe and judge the grasp in a scene, and connects them."""
    view = add_view(builder, scene, description, scene.object_body)
    monitor = builder.AddNamedSystem(
        "grasp_monitor",
        GraspMonitor(
            len(description.fingers),
            view.links,
            scene.object_shape.lowest_point,
            scenario.object.support_height,
            scenario.monitor,
        ),
    )
    for name in ("object_pose", "hand_pose", "contact", "link_contact", "self_contact"):
        builder.Connect(view.GetOutputPort(name), monitor.GetInputPort(name))
    return view, monitor


TASK = GraspTask()
