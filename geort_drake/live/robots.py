"""Simulated robots: one inside the teleoperation diagram, and a stand-in for a real one behind an address."""

import time
from collections.abc import Sequence

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams, MeshcatVisualizer
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    DiagramBuilder,
    DiscreteStateIndex,
    DiscreteValues,
    EventStatus,
)

from geort_drake.hands.description import HandDescription, load_hand
from geort_drake.live.glove_stream import POLL_PERIOD
from geort_drake.live.joint_messages import Bus, JointState, JointTargets
from geort_drake.live.robot_buses import open_stand_in_bus
from geort_drake.simulation.following import JointGroup, RobotModel, robot_model
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.world import ARM, HAND, actuated_state
from geort_drake.systems.python_system import PythonSystem

# Time between statuses, s.
STATUS_PERIOD = 0.004


class SimulatedRobot:
    """Simulates a scenario's arm, hand and task; the scenario's seed places the object.

    Input ports of `diagram`:
        hand_desired_state (2n), arm_desired_state (2m): joint positions (rad), then velocities (rad/s),
            in the plant's actuator order.
    Output ports:
        hand_state (2n), arm_state (2m): measured positions (rad), then velocities (rad/s), in the same order.
        body_poses (abstract list of RigidTransform): X_WB by the plant's body index.

    Attributes:
        diagram: the simulation; not a base class, as Drake never frees subclasses in Python (drake#24162).
        hand, arm: the joints of each.
        stage: the task's stage.

    Args:
        scenario: task, arm and simulation settings.
        description: the hand's description.
        model: the robot's model.
        meshcat: viewer that shows the scene, if any.

    Raises:
        ScenarioError, HandError: scenario and models do not fit together.
    """

    def __init__(
        self,
        scenario: Scenario,
        description: HandDescription,
        model: RobotModel,
        meshcat: Meshcat | None = None,
    ):
        builder = DiagramBuilder()
        rng = np.random.default_rng(scenario.random_seed)
        task = find_task(scenario.task)
        self.stage = task.add_stage(builder, scenario, description, None, model.X_WB, rng)
        scene = self.stage.scene
        plant, hand, arm = scene.plant, scene.hand, scene.arm
        for instance, name in ((hand, HAND), (arm, ARM)):
            builder.ExportInput(plant.get_desired_state_input_port(instance), f"{name}_desired_state")
            builder.ExportOutput(actuated_state(builder, plant, instance), f"{name}_state")
        if meshcat is not None:
            MeshcatVisualizer.AddToBuilder(builder, scene.scene_graph, meshcat)
        builder.ExportOutput(plant.get_body_poses_output_port(), "body_poses")
        self.diagram = builder.Build()
        self.hand, self.arm = JointGroup.of_plant(plant, hand), JointGroup.of_plant(plant, arm)


def open_meshcat() -> Meshcat:
    """Returns a viewer that only this machine can reach."""
    return Meshcat(MeshcatParams(host="localhost"))


class JointServer(PythonSystem):
    """Replaces a robot's driver: follows the newest joint targets and publishes the joints' state.

    It follows positions only, with desired velocities of zero, so the joints lag. Targets are clamped to the
    limits. The robot holds its last command when no more come.

    Input ports:
        hand_state (2n), arm_state (2m): measured positions (rad), then velocities (rad/s), in the order of
            `groups`.
    Output ports:
        hand_desired_state (2n), arm_desired_state (2m): joint positions (rad), then velocities (rad/s).

    State: the commanded positions, rad; before the first command, the initial positions.

    Attributes:
        bus: the bus, which counts what it refuses.

    Args:
        bus: the driver's end of a bus.
        groups: the joints of hand and arm.
    """

    def __init__(self, bus: Bus[JointState, JointTargets], groups: Sequence[JointGroup]):
        super().__init__()
        self.bus, self._groups, self._sequence = bus, list(groups), 0
        self._measured = [self.DeclareVectorInputPort(f"{g.name}_state", 2 * len(g.joints)) for g in groups]
        self._commanded = [self.DeclareDiscreteState(group.start) for group in groups]
        for group, index in zip(groups, self._commanded, strict=True):
            self.DeclareVectorOutputPort(
                f"{group.name}_desired_state",
                2 * len(group.joints),
                lambda context, output, index=index: self._calc_desired(context, output, index),
                {self.discrete_state_ticket(index)},
            )
        self.DeclarePeriodicDiscreteUpdateEvent(POLL_PERIOD, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(STATUS_PERIOD, 0.0, self._publish)

    def _calc_desired(self, context: Context, output: BasicVector, index: DiscreteStateIndex) -> None:
        q = context.get_discrete_state(index).value()
        output.SetFromVector(np.concatenate([q, np.zeros_like(q)]))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        wanted: dict[str, float] = {}
        for targets in self.bus.fetch():
            wanted |= dict(zip(targets.names, targets.position.tolist(), strict=True))
        for group, index in zip(self._groups, self._commanded, strict=True):
            q = context.get_discrete_state(index).value()
            q = np.array([wanted.get(name, float(old)) for name, old in zip(group.joints, q, strict=True)])
            discrete_state.get_mutable_vector(index).SetFromVector(np.clip(q, group.lower, group.upper))
        return EventStatus.Succeeded()

    def _publish(self, context: Context) -> EventStatus:
        q, v = np.concatenate([port.Eval(context).reshape(2, -1) for port in self._measured], axis=1)
        names = [name for group in self._groups for name in group.joints]
        self._sequence += 1
        self.bus.send(JointState(self._sequence, time.monotonic(), names, q, v))
        return EventStatus.Succeeded()


def make_stand_in(scenario: Scenario, address: str, meshcat: Meshcat | None = None) -> Diagram:
    """Builds a diagram that simulates the scenario's robot behind an address; run it in real time.

    Raises:
        ScenarioError, HandError: scenario and models do not fit, or the hand has no LCM messages.
        LiveError: the address is malformed.
    """
    description = load_hand(scenario.hand)
    builder = DiagramBuilder()
    simulated = SimulatedRobot(scenario, description, robot_model(scenario, description), meshcat)
    robot = builder.AddNamedSystem("robot", simulated.diagram)
    groups = (simulated.hand, simulated.arm)
    server = builder.AddNamedSystem("server", JointServer(open_stand_in_bus(address, description), groups))
    for group in groups:
        state, desired = f"{group.name}_state", f"{group.name}_desired_state"
        builder.Connect(robot.GetOutputPort(state), server.GetInputPort(state))
        builder.Connect(server.GetOutputPort(desired), robot.GetInputPort(desired))
    diagram = builder.Build()
    diagram.set_name("stand_in_robot")
    return diagram
