"""Simulated robots: one inside the teleoperation diagram, and a stand-in for a real one behind LCM."""

import time

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams, MeshcatVisualizer
from pydrake.lcm import DrakeLcm
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    DiagramBuilder,
    DiscreteValues,
    EventStatus,
)

from geort_drake.hands.description import HandDescription, load_hand
from geort_drake.live.devices import (
    ALLEGRO,
    PANDA,
    Device,
    JointStatus,
    LcmInbox,
    require_hand_messages,
)
from geort_drake.live.glove_stream import POLL_PERIOD
from geort_drake.live.transports import open_lcm
from geort_drake.simulation.following import JointGroup, RobotModel
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
    """Replaces a device's driver: follows the newest usable command and publishes the joints' state.

    Commands hold positions only, so the desired velocities are zero and the joints lag.

    Input port:
        state (2n): measured positions (rad), then velocities (rad/s), in the order of `group`.
    Output port:
        desired_state (2n): joint positions (rad), then velocities (rad/s), in the same order.

    State: the commanded positions (n), rad; before the first command, the initial positions.

    Attributes:
        inbox: the newest command; malformed or non-finite commands are refused.

    Args:
        device: device whose messages are used.
        lcm: the bus.
        group: the model's joints; commands are clamped to their limits.

    Raises:
        HandError: device and model have different joints.
    """

    def __init__(self, device: Device, lcm: DrakeLcm, group: JointGroup):
        super().__init__()
        self._device, self._lcm, self._group = device, lcm, group
        self._to_model = device.model_order(group)
        self.inbox = LcmInbox(lcm, {device.command_channel: device.decode_command})
        n = len(group.joints)
        self._measured = self.DeclareVectorInputPort("state", 2 * n)
        self._commanded = self.DeclareDiscreteState(group.start)
        ticket = {self.discrete_state_ticket(self._commanded)}
        self.DeclareVectorOutputPort("desired_state", 2 * n, self._calc_desired, ticket)
        self.DeclarePeriodicDiscreteUpdateEvent(POLL_PERIOD, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(STATUS_PERIOD, 0.0, self._publish)

    def _calc_desired(self, context: Context, output: BasicVector) -> None:
        q = context.get_discrete_state(self._commanded).value()
        output.SetFromVector(np.concatenate([q, np.zeros_like(q)]))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        self.inbox.fetch()
        command = self.inbox.newest.get(self._device.command_channel)
        if command is not None:
            q = np.clip(command[self._to_model], self._group.lower, self._group.upper)
            discrete_state.get_mutable_vector(self._commanded).SetFromVector(q)
        return EventStatus.Succeeded()

    def _publish(self, context: Context) -> EventStatus:
        position, velocity = np.split(self._measured.Eval(context), 2)
        parts = (position, velocity, context.get_discrete_state(self._commanded).value())
        status = JointStatus(*(part[np.argsort(self._to_model)] for part in parts))
        self._lcm.Publish(self._device.status_channel, self._device.encode_status(time.monotonic(), status))
        return EventStatus.Succeeded()


def make_stand_in(scenario: Scenario, url: str, meshcat: Meshcat | None = None) -> Diagram:
    """Builds a diagram that simulates the scenario's robot behind LCM; run it in real time.

    Raises:
        ScenarioError, HandError: scenario and models do not fit, or are not an Allegro hand and a Panda arm.
        LiveError: the URL is malformed.
    """
    description = load_hand(scenario.hand)
    require_hand_messages(description)
    builder = DiagramBuilder()
    simulated = SimulatedRobot(scenario, description, RobotModel(scenario, description), meshcat)
    robot = builder.AddNamedSystem("robot", simulated.diagram)
    for device, group in ((ALLEGRO, simulated.hand), (PANDA, simulated.arm)):
        server = builder.AddNamedSystem(f"{group.name}_server", JointServer(device, open_lcm(url), group))
        builder.Connect(robot.GetOutputPort(f"{group.name}_state"), server.GetInputPort("state"))
        builder.Connect(
            server.GetOutputPort("desired_state"), robot.GetInputPort(f"{group.name}_desired_state")
        )
    diagram = builder.Build()
    diagram.set_name("stand_in_robot")
    return diagram
