"""Base class of tasks for the fingers of a hand that stays in place."""

import abc
import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.multibody.tree import Joint, RigidBody
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from geort_drake.hands.description import HandDescription
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.simulation.finger_planner import FingerPlanner
from geort_drake.simulation.monitor import TaskMonitor, TaskSettings
from geort_drake.simulation.operators.finger_person import FingerPerson
from geort_drake.simulation.operators.goal import Intended
from geort_drake.simulation.operators.intention import ADAPTIVE, MIMICRY, SERVO
from geort_drake.simulation.operators.simulated_operator import Person
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import Signals, Stage, States, Task
from geort_drake.simulation.view import add_monitor, add_view, shown_by
from geort_drake.simulation.world import add_robot, finish_scene, joint_state


@dc.dataclass(frozen=True, eq=False)
class Handled:
    """An object that the fingers handle, in a plant that is not finalized.

    Attributes:
        body: the body that the person sees and touches.
        parts: other bodies that count as parts of it.
        joints: joints for the monitor's input port `joints`, which gets their positions, then velocities.
    """

    body: RigidBody
    parts: Sequence[RigidBody] = ()
    joints: Sequence[Joint] = ()


class FingerTask(Task[Intended]):
    """A task for the fingers of a hand that stays in place; all kinds of people can do it.

    Attributes:
        settings: dataclass of the scenario's `task_settings`.
        planner: class that plans the goals.
        monitor_type: class of the monitor, made from number of fingers and settings by `make_monitor`.
        person_type: class that decides how the fingers move.
        percepts: ports of view or monitor that the person perceives besides fingertips and hand pose.
    """

    kinds = (ADAPTIVE, MIMICRY, SERVO)
    settings: ClassVar[type[TaskSettings]]
    planner: ClassVar[type[FingerPlanner]]
    monitor_type: ClassVar[type[TaskMonitor]]
    person_type: ClassVar[type[FingerPerson]]
    percepts: ClassVar[tuple[str, ...]]

    @abc.abstractmethod
    def add_handled(
        self, plant: MultibodyPlant, goal: Intended, X_WB: RigidTransform, rng: np.random.Generator
    ) -> Handled:
        """Adds the object to the plant, for a hand at X_WB."""

    def make_monitor(
        self, num_fingers: int, goal: Intended, X_WB: RigidTransform, settings: Any, rng: np.random.Generator
    ) -> TaskMonitor:
        """Returns the monitor; `rng` has already been used by `add_handled`."""
        return self.monitor_type(num_fingers, settings)

    @abc.abstractmethod
    def recorded(self, monitor: TaskMonitor, settings: Any) -> tuple[States, Signals]:
        """Returns the states and signals of `Stage` for recordings."""

    def check_settings(self, settings: Mapping[str, float]) -> None:
        names = [field.name for field in dc.fields(self.settings)]
        for name in settings:
            if name not in names:
                raise ValueError(f"task_settings has no '{name}'; the settings are: {', '.join(names)}")
        self.settings(**settings)

    def plans(self, scenario: Scenario, description: HandDescription) -> list[Intended]:
        return [plan.goal for plan in self.planner(description).plans()]

    def add_stage(
        self,
        builder: DiagramBuilder,
        scenario: Scenario,
        description: HandDescription,
        goal: Intended | None,
        X_WB: RigidTransform,
        rng: np.random.Generator,
    ) -> Stage:
        goal = goal or self.plans(scenario, description)[0]
        settings: Any = self.settings(**scenario.task_settings)
        plant, scene_graph = AddMultibodyPlant(scenario.plant_config, builder)
        add_robot(plant, scenario, description)
        handled = self.add_handled(plant, goal, X_WB, rng)
        scene = finish_scene(plant, scene_graph, scenario, description)
        view = add_view(builder, scene, description, handled.body, handled.parts)
        brake = plant.get_desired_state_input_port(handled.body.model_instance())
        if brake.size():  # the object's actuated joint is a brake
            zeros = builder.AddSystem(ConstantVectorSource(np.zeros(brake.size())))
            builder.Connect(zeros.get_output_port(), brake)
        monitor = self.make_monitor(len(description.fingers), goal, X_WB, settings, rng)
        add_monitor(builder, f"{self.name}_monitor", monitor, view)
        if handled.joints:
            builder.Connect(joint_state(builder, plant, handled.joints), monitor.GetInputPort("joints"))
        shown = shown_by(view, monitor, ("fingertips", "hand_pose", *self.percepts))
        states, signals = self.recorded(monitor, settings)
        return Stage(scene, monitor, shown, states, signals=signals)

    def person(self, scenario: Scenario, hand: HumanHand, goal: Intended, rng: np.random.Generator) -> Person:
        config, intention = scenario.operator, scenario.intention
        return self.person_type(hand, goal, scenario.kind, config, intention, rng)
