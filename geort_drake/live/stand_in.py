"""A robot that is not there: the LCM side of an Allegro hand and a Panda arm, with physics behind it."""

import time
from collections.abc import Callable

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.lcm import DrakeLcm
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    DiagramBuilder,
    DiscreteValues,
    EventStatus,
    LeafSystem,
)

from geort_drake.hands.description import load_hand
from geort_drake.live.devices import ALLEGRO, PANDA, Device, JointStatus, require_hand_messages
from geort_drake.live.glove_stream import POLL_PERIOD
from geort_drake.live.joint_group import JointGroup
from geort_drake.live.lcm_inbox import LcmInbox
from geort_drake.live.simulated_robot import SimulatedRobot
from geort_drake.live.transports import open_lcm
from geort_drake.simulation.scenario import Scenario

# Time between statuses, s.
STATUS_PERIOD = 0.004


class JointServer(LeafSystem):
    """A device's driver: follows the newest good command, holds the last one, and tells its state.

    Commands have positions alone, so the velocities asked for are zero, and joints lag as those of a real
    driver do.

    Input port:
        state (2n): measured, in the order of the group.
    Output port:
        desired_state (2n): same order.

    State: the commanded positions, n; before the first command, where the joints start.

    Attributes:
        inbox: what came; commands that are malformed or not finite are refused there.

    Args:
        group: the model's joints, where they start and their limits; commands are clamped to these.
        clock: of the time in messages, s.
    """

    def __init__(
        self,
        device: Device,
        lcm: DrakeLcm,
        group: JointGroup,
        clock: Callable[[], float] = time.monotonic,
    ):
        super().__init__()
        device.require_joints(group)
        self._device, self._lcm, self._clock, self._group = device, lcm, clock, group
        self._to_model = np.array([device.joints.index(name) for name in group.joints])
        self._to_device = np.argsort(self._to_model)
        self.inbox = LcmInbox(lcm, {device.command_channel: device.decode_command}, clock)
        self._n = n = len(group.joints)
        self._measured = self.DeclareVectorInputPort("state", 2 * n)
        self._commanded = self.DeclareDiscreteState(group.start)
        self.DeclareVectorOutputPort(
            "desired_state", 2 * n, self._calc, {self.discrete_state_ticket(self._commanded)}
        )
        self.DeclarePeriodicDiscreteUpdateEvent(POLL_PERIOD, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(STATUS_PERIOD, 0.0, self._publish)

    def _calc(self, context: Context, output: BasicVector) -> None:
        q = context.get_discrete_state(self._commanded).value()
        output.SetFromVector(np.concatenate([q, np.zeros(self._n)]))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        self.inbox.fetch()
        newest = self.inbox.newest.get(self._device.command_channel)
        if newest is not None:
            q = np.clip(newest.contents[self._to_model], self._group.lower, self._group.upper)
            discrete_state.get_mutable_vector(self._commanded).SetFromVector(q)
        return EventStatus.Succeeded()

    def _publish(self, context: Context) -> EventStatus:
        measured = self._measured.Eval(context)
        commanded = context.get_discrete_state(self._commanded).value()
        parts = (measured[: self._n], measured[self._n :], commanded)
        status = JointStatus(*(part[self._to_device] for part in parts))
        message = self._device.encode_status(self._clock(), status)
        self._lcm.Publish(self._device.status_channel, message)
        return EventStatus.Succeeded()


def make_stand_in(scenario: Scenario, url: str, meshcat: Meshcat | None = None) -> Diagram:
    """The scenario's robot behind LCM; simulate it in real time.

    Raises:
        ScenarioError, HandError: scenario and models do not fit, or are no Allegro hand and Panda.
        LiveError: the URL is malformed.
    """
    description = load_hand(scenario.hand)
    require_hand_messages(description)
    builder = DiagramBuilder()
    robot = builder.AddNamedSystem("robot", SimulatedRobot(scenario, description, meshcat))
    for device, group in ((ALLEGRO, robot.hand), (PANDA, robot.arm)):
        server = builder.AddNamedSystem(f"{group.name}_server", JointServer(device, open_lcm(url), group))
        builder.Connect(robot.GetOutputPort(f"{group.name}_state"), server.GetInputPort("state"))
        builder.Connect(
            server.GetOutputPort("desired_state"), robot.GetInputPort(f"{group.name}_desired_state")
        )
    diagram = builder.Build()
    diagram.set_name("stand_in_robot")
    return diagram
