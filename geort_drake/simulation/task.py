"""What a task is: its scene, cases, plans, the person's behaviour, and a function that judges it, as data.

`geort_drake.simulation.tasks` finds the tasks.
"""

import dataclasses as dc
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex, RigidBody, SpatialInertia
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, OutputPort, State
from pydrake.systems.primitives import ConstantVectorSource

from geort_drake.errors import UnknownNameError
from geort_drake.hands.description import HandDescription
from geort_drake.settings import check_names, require_numbers
from geort_drake.simulation.person.engine import Phase
from geort_drake.simulation.person.goal import Goal
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import ARM, HAND, add_robot, finalize, joint_state
from geort_drake.systems.port_values import Immutable, pose_to_vector
from geort_drake.systems.python_system import PythonSystem
from geort_drake.systems.scene_view import SceneView

PERIOD = 0.01  # s between two observations
# Scenario of tasks for the fingers of a parked hand; its timeout, s, is enough with a good map.
PARKED_HAND = """
kind: adaptive
timeout: 60.0
directives: [{add_directives: {file: package://geort_drake/diagrams/parked_hand.dmd.yaml}}]
hand_parent: arm::hand_side
fixed_base: true
"""

# Name of an input port of the judge → its values.
Observation = Mapping[str, np.ndarray]


@dc.dataclass(frozen=True)
class Outcome(Immutable):
    """Result of a task so far, and what its judge remembers.

    Attributes:
        began: time at which the task began, s.
        t: time of the last observation, s.
        phase: number of the task's present state.
        success: whether the task is done.
        over: whether the task is decided.
        score: how much of the task is done, from 0 to 1.
        completion_time: simulation time of the success, s; NaN without success.
        text: "success", or the reason for failure if the trial ended now.
        metrics: further figures of the result, as JSON types.
        memory: what the judge needs at the next observation; empty before the first.
        peak_force: largest contact force between a finger and the object, N.
        self_contact_time: total time in which links of the hand touched each other, s; see `SceneView`.
    """

    began: float = 0.0
    t: float = 0.0
    phase: int = 0
    success: bool = False
    over: bool = False
    score: float = 0.0
    completion_time: float = math.nan
    text: str = ""
    metrics: Mapping[str, Any] = dc.field(default_factory=dict)
    memory: Mapping[str, Any] = dc.field(default_factory=dict)
    peak_force: float = 0.0
    self_contact_time: float = 0.0


# Returns the next outcome without changing the one before, whose `t` is the present time; the judge adds
# forces and contacts.
Judgement = Callable[[Outcome, Observation], Outcome]


@dc.dataclass(frozen=True, eq=False)
class Handled:
    """What the hand handles, and how that is judged.

    Attributes:
        body: the body that the person sees and touches.
        judgement: judges the task.
        states: names of the states that `Outcome.phase` counts.
        parts: other bodies that count as parts of the body.
        joints: K joints whose positions and velocities are judged; and the names and unit of their positions.
        mass_factor: factor on the mass of a free body, which falls; None if it is held in place.
        X_WP: where the body belongs, which the person sees; None if it has no place.
    """

    body: RigidBody
    judgement: Judgement
    states: Sequence[str]
    parts: Sequence[RigidBody] = ()
    joints: Sequence[Joint] = ()
    positions: tuple[Sequence[str], str] = ((), "")
    mass_factor: float | None = None
    X_WP: RigidTransform | None = None


class Judge(PythonSystem):
    """Judges a task periodically, without delay or noise, and ends the simulation once it is decided.

    Input ports (F fingers, L links, K joints):
        contact (F): force between each finger and the object, N.
        self_contact (1): above 0 while links of the hand touch each other.
        object_pose (7): X_WO, qw qx qy qz x y z.
        link_contact (L): force between each link of the hand and the object, N.
        joints (2K): positions, then velocities of the object's joints; only if it has any.
    Output ports:
        phase (1): number of the task's present state.
        positions (K): positions of the object's joints; only if it has any.
        place_pose (7): X_WP, where the object belongs; only if it has a place.

    State (abstract): the outcome.

    Args:
        num_fingers, num_links: F and L.
    """

    def __init__(self, handled: Handled, num_fingers: int, num_links: int):
        super().__init__()
        self._judgement = handled.judgement
        num_joints, X_WP = len(handled.joints), handled.X_WP
        sizes = {"contact": num_fingers, "self_contact": 1, "object_pose": 7}
        sizes |= {"link_contact": num_links, "joints": 2 * num_joints}
        self._inputs = {name: self.DeclareVectorInputPort(name, size) for name, size in sizes.items() if size}
        state = self.DeclareAbstractState(AbstractValue.Make(Outcome()))
        self.DeclareVectorOutputPort(
            "phase",
            1,
            lambda context, output: output.SetAtIndex(0, self.outcome(context).phase),
            {self.abstract_state_ticket(state)},
        )
        if num_joints:
            joints = self._inputs["joints"]
            self.DeclareVectorOutputPort(
                "positions",
                num_joints,
                lambda context, output: output.SetFromVector(joints.Eval(context)[:num_joints]),
                {joints.ticket()},
            )
        if X_WP is not None:
            place = pose_to_vector(X_WP)
            self.DeclareVectorOutputPort(
                "place_pose", 7, lambda _, output: output.SetFromVector(place), {self.nothing_ticket()}
            )
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._observe)

    def outcome(self, context: Context) -> Outcome:
        """Returns the outcome so far."""
        return context.get_abstract_state(0).get_value()

    def restart(self, context: Context) -> None:
        """Restarts the task at the present time."""
        context.SetAbstractState(0, Outcome(began=context.get_time()))

    def _observe(self, context: Context, state: State) -> EventStatus:
        previous, t = self.outcome(context), context.get_time()
        if previous.over:
            return EventStatus.DidNothing()
        observation = {name: port.Eval(context) for name, port in self._inputs.items()}
        touches_itself = t > 0 and observation["self_contact"][0] > 0
        outcome = self._judgement(previous.replace(t=t), observation).replace(
            peak_force=max(previous.peak_force, float(observation["contact"].max())),
            self_contact_time=previous.self_contact_time + PERIOD * bool(touches_itself),
        )
        state.get_mutable_abstract_state(0).set_value(outcome)
        if outcome.over:
            return EventStatus.ReachedTermination(self, "the task is judged")
        return EventStatus.Succeeded()


class Site(NamedTuple):
    """Where a task adds what the hand handles: a plant with the robot that is not finalized.

    Attributes:
        goal: the person's goal.
        X_WB: initial pose of the hand.
        settings: the task's settings.
        rng: draws everything that depends on the seed.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    scenario: Scenario
    description: HandDescription
    goal: Any
    X_WB: RigidTransform
    settings: Any
    rng: np.random.Generator


@dc.dataclass(frozen=True, eq=False)
class Stage:
    """The plant of a trial, with the robot and what it handles, and the judge.

    Attributes:
        arm, hand: models whose joints the plant's PD controllers drive.
        fixed_base: whether the arm keeps its position.
        percepts: name of the person's input port → the port that it perceives.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    arm: ModelInstanceIndex
    hand: ModelInstanceIndex
    handled: Handled
    fixed_base: bool
    judge: Judge
    percepts: Mapping[str, OutputPort]

    def initialize(self, root: Context) -> None:
        """Sets what only a context can hold: the locks of a fixed base's joints, and the object's mass."""
        context = self.plant.GetMyMutableContextFromRoot(root)
        for index in self.plant.GetJointIndices(self.arm) if self.fixed_base else ():
            self.plant.get_joint(index).Lock(context)
        body, factor = self.handled.body, self.handled.mass_factor
        if factor is not None:
            M = body.CalcSpatialInertiaInBodyFrame(context)
            scaled = SpatialInertia(factor * M.get_mass(), M.get_com(), M.get_unit_inertia())
            body.SetSpatialInertiaInBodyFrame(context, scaled)

    def outcome(self, root: Context) -> Outcome:
        """Returns the outcome so far."""
        return self.judge.outcome(self.judge.GetMyContextFromRoot(root))

    def phase(self, root: Context) -> str:
        """Returns the name of the task's present state."""
        return self.handled.states[self.outcome(root).phase]

    def restart(self, root: Context) -> None:
        """Restarts the task at the present time, when the person is ready."""
        self.judge.restart(self.judge.GetMyMutableContextFromRoot(root))


@dc.dataclass(frozen=True)
class NoSettings:
    """The settings of a task without any."""


@dc.dataclass(eq=False)
class Task:
    """A task; each module of `tasks` defines one named `TASK`.

    Attributes:
        name: name of the task and its module.
        summary: one line for --help.
        scenario: YAML of its scenario, see `Scenario`, or a file and the scenario's name in it.
        plans: goals for the scenario's robot, best first. Raises ScenarioError if there are none.
        add: adds to the plant what the hand handles. Raises ScenarioError or HandError if scenario and models
            do not fit together.
        phases: the person's behaviour.
        percepts: ports of the judge that the person perceives besides those of the view.
        objects: objects to choose from, one per trial; empty for a task without a choice.
        settings: dataclass of positive numbers for the scenario's `task_settings`.
        placing: how the person places the object, if they do, with `hover` and `upright` of a `Transfer`.
        begins_straight: whether the person's fingers are straight at first, because bent ones would collide.
    """

    name: str
    summary: str
    scenario: str | tuple[Path, str]
    plans: Callable[[Scenario, HandDescription], Sequence[Goal]]
    add: Callable[[Site], Handled]
    phases: tuple[Phase, ...]
    percepts: tuple[str, ...] = ()
    objects: Sequence[str] = ()
    settings: type = NoSettings
    placing: Any = None
    begins_straight: bool = False

    def cases(self) -> list[str]:
        """Returns the cases of the task, one per trial, such as objects."""
        return [*self.objects] or [self.name]

    def choose(self, scenario: Scenario, case: str) -> None:
        """Sets the case in a scenario; raises UnknownNameError if there is none of that name."""
        if case not in self.cases():
            raise UnknownNameError("object", case, self.cases())
        if self.objects:
            scenario.object.name = case

    def case_of(self, scenario: Scenario) -> str:
        """Returns the case of a scenario."""
        return scenario.object.name if self.objects else self.name

    def settings_of(self, scenario: Scenario) -> Any:
        """Returns the settings of a scenario.

        Raises:
            UnknownNameError: there is no such setting.
            ValueError: a setting is out of range.
        """
        check_names(scenario.task_settings, self.settings, f"{self.name} (task_settings)")
        settings = self.settings(**scenario.task_settings)
        require_numbers(settings, "task_settings")
        return settings

    def add_stage(
        self,
        builder: DiagramBuilder,
        scenario: Scenario,
        description: HandDescription,
        goal: Goal | None,
        X_WB: RigidTransform,
        rng: np.random.Generator,
    ) -> Stage:
        """Adds plant, view and judge to a diagram.

        Args:
            goal: the person's goal; None in a replay.
            X_WB: initial pose of the hand.
            rng: draws everything that depends on the seed.

        Raises:
            ScenarioError, HandError: the scenario and the models do not fit together.
        """
        plant, scene_graph = AddMultibodyPlant(scenario.plant_config, builder)
        add_robot(plant, scenario, description)
        settings = self.settings_of(scenario)
        if goal is None and not self.objects:  # the place of what is handled depends on the goal
            goal = self.plans(scenario, description)[0]
        handled = self.add(Site(plant, scene_graph, scenario, description, goal, X_WB, settings, rng))
        body = handled.body
        is_free = handled.mass_factor is not None
        finalize(plant, scenario, description, body.model_instance() if is_free else None)
        arm, hand = plant.GetModelInstanceByName(ARM), plant.GetModelInstanceByName(HAND)
        inspector = scene_graph.model_inspector()
        parts = [part.index() for part in handled.parts]
        view = builder.AddNamedSystem(
            "scene_view", SceneView(plant, description, hand, body.index(), inspector, parts)
        )
        builder.Connect(plant.get_body_poses_output_port(), view.GetInputPort("body_poses"))
        builder.Connect(plant.get_contact_results_output_port(), view.GetInputPort("contact_results"))
        brake = plant.get_desired_state_input_port(body.model_instance())
        if brake.size():  # the object's actuated joint is a brake
            zeros = builder.AddSystem(ConstantVectorSource(np.zeros(brake.size())))
            builder.Connect(zeros.get_output_port(), brake)
        judge = builder.AddNamedSystem("judge", Judge(handled, len(description.fingers), len(view.links)))
        for port in map(judge.get_input_port, range(judge.num_input_ports())):
            if view.HasOutputPort(port.get_name()):
                builder.Connect(view.GetOutputPort(port.get_name()), port)
        if handled.joints:
            builder.Connect(joint_state(builder, plant, handled.joints), judge.GetInputPort("joints"))
        percepts = {}
        for name in ("fingertips", "hand_pose", "object_pose", "contact", *self.percepts):
            system = view if view.HasOutputPort(name) else judge
            percepts[name] = system.GetOutputPort(name)
        return Stage(plant, scene_graph, arm, hand, handled, scenario.fixed_base, judge, percepts)


@dc.dataclass(frozen=True)
class TrialResult:
    """Result of one trial; times in simulated s."""

    # Name of the task, and of its case, the object.
    task: str
    object: str
    seed: int
    success: bool
    # Degree of success from 0 to 1.
    score: float
    # "success", or the reason for failure.
    outcome: str
    # The simulated operator's last phase, for example approach or close; None in a replay.
    operator_phase: str | None
    # Time from the start to success; None without success.
    completion_time: float | None
    # Whether the first attempt succeeded, and the number of attempts; None in a replay.
    first_attempt: bool | None
    attempts: int | None
    simulated_time: float
    # Fraction of the time during which two links of the hand touched each other, see `SceneView`.
    self_contact: float
    peak_force: float
    wall_time: float
    # Figures of the task, described in its module.
    metrics: Mapping[str, Any] = dc.field(default_factory=dict)

    def to_json(self) -> dict:
        """Returns plain JSON types; the task's figures stand beside the others."""
        values = dc.asdict(self)
        return values | values.pop("metrics")
