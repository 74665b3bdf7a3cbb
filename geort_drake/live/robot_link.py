"""A robot on LCM, as a system: it is sent joint positions and tells where its joints are."""

import math
import time
from collections.abc import Callable

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, EventStatus, LeafSystem

from geort_drake.errors import LiveError
from geort_drake.live.devices import ALLEGRO, PANDA, Device, JointStatus
from geort_drake.live.glove_stream import POLL_PERIOD
from geort_drake.live.joint_group import JointGroup
from geort_drake.live.lcm_inbox import LcmInbox
from geort_drake.live.transports import open_lcm, wait_for
from geort_drake.live.watchdog import AFTER

# A joint may be measured so far outside its limits, rad; farther, it is another robot's.
_TOLERANCE = 0.1


class RobotLink(LeafSystem):
    """An Allegro hand and a Panda arm behind Drake's `lcmt_allegro_*` and `lcmt_panda_*`.

    Input ports:
        hand_desired_state (32), arm_desired_state (14): joint positions (rad), then velocities (rad/s), in
            the order of `hand` and `arm`. The positions are sent.
    Output ports:
        hand_state (32), arm_state (14): measured, same order.
        hand_commanded (16): the command that the hand says it follows, rad; NaN before the first.

    State: what the ports give. Statuses are fetched in a discrete update every `POLL_PERIOD`; commands are
    published every `period`, as soon as they are computed.

    Args:
        url: of the LCM bus.
        hand, arm: the model's joints.
        period: of the commands, s.
        clock: monotonic, s.

    Raises:
        HandError: the model's joints are not those of an Allegro hand and a Panda.
        LiveError: the URL is malformed.
    """

    def __init__(
        self,
        url: str,
        hand: JointGroup,
        arm: JointGroup,
        period: float,
        clock: Callable[[], float] = time.monotonic,
    ):
        super().__init__()
        self._lcm, self._clock = open_lcm(url), clock
        self.inbox = LcmInbox(self._lcm, {d.status_channel: d.decode_status for d in (ALLEGRO, PANDA)}, clock)
        self._parts = (_Part(ALLEGRO, hand), _Part(PANDA, arm))
        self._commands = [
            self.DeclareVectorInputPort(f"{part.name}_desired_state", 2 * part.n) for part in self._parts
        ]
        # Each part: positions, velocities, commanded positions.
        self._states = [self.DeclareDiscreteState(np.full(3 * part.n, math.nan)) for part in self._parts]
        for part, state in zip(self._parts, self._states, strict=True):
            self.DeclareVectorOutputPort(
                f"{part.name}_state",
                2 * part.n,
                lambda context, output, state=state, n=part.n: output.SetFromVector(
                    context.get_discrete_state(state).value()[: 2 * n]
                ),
                {self.discrete_state_ticket(state)},
            )
        n, state = self._parts[0].n, self._states[0]
        self.DeclareVectorOutputPort(
            "hand_commanded",
            n,
            lambda context, output: output.SetFromVector(context.get_discrete_state(state).value()[2 * n :]),
            {self.discrete_state_ticket(state)},
        )
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(POLL_PERIOD, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(period, 2 * AFTER, self._publish)

    def handshake(self, timeout_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Waits for the robot, looks whether it is the model's, and says where it stands.

        Returns:
            Positions of hand (16,) and arm (7,), rad, in the order of the ports, within the limits.

        Raises:
            LiveError: no status came in time, or a joint is far outside its limits.
        """

        def poll() -> bool | None:
            self.inbox.fetch()
            return True if len(self.inbox.newest) == len(self._parts) else None

        wait_for(poll, timeout_s, lambda: self._silence(timeout_s))
        positions = []
        for part in self._parts:
            lower, upper = part.group.lower, part.group.upper
            q = self._status(part).position[part.to_model]
            within = np.clip(q, lower, upper)
            worst = int(np.argmax(np.abs(q - within)))
            if abs(q[worst] - within[worst]) > _TOLERANCE:
                raise LiveError(
                    f"{part.device.name}: {part.group.joints[worst]} is at {q[worst]:.3f} rad, limits are "
                    f"[{lower[worst]:.3f}, {upper[worst]:.3f}]. Is this the hand that the robot has?"
                )
            positions.append(within)
        return positions[0], positions[1]

    def require_alive(self, silence_s: float) -> None:
        """Raises LiveError where a part of the robot has said nothing for so long, s."""
        for part in self._parts:
            silent = self._clock() - self.inbox.newest[part.device.status_channel].arrived
            if silent > silence_s:
                raise LiveError(
                    f"{part.device.name}: no {part.device.status_channel} for {silent:.1f} s; commands "
                    "have stopped, because the robot may be elsewhere when it comes back"
                )

    def _silence(self, timeout_s: float) -> str:
        missing = [
            part.device.status_channel
            for part in self._parts
            if part.device.status_channel not in self.inbox.newest
        ]
        refused = f"; {self.inbox.refused} messages were refused, the last: {self.inbox.last_refusal}"
        return f"no robot: {' and '.join(missing)} did not come within {timeout_s:g} s" + (
            refused if self.inbox.refused else ""
        )

    def _status(self, part: "_Part") -> JointStatus:
        return self.inbox.newest[part.device.status_channel].contents

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        self.inbox.fetch()
        for part, state in zip(self._parts, self._states, strict=True):
            if part.device.status_channel in self.inbox.newest:
                status = self._status(part)
                values = [v[part.to_model] for v in (status.position, status.velocity, status.commanded)]
                discrete_state.get_mutable_vector(state).SetFromVector(np.concatenate(values))
        return EventStatus.Succeeded()

    def _publish(self, context: Context) -> EventStatus:
        for part, port in zip(self._parts, self._commands, strict=True):
            q = port.Eval(context)[: part.n][part.to_device]
            self._lcm.Publish(part.device.command_channel, part.device.encode_command(self._clock(), q))
        return EventStatus.Succeeded()


class _Part:
    """A device, and how its joints' order and the model's go into each other."""

    def __init__(self, device: Device, group: JointGroup):
        device.require_joints(group)
        self.device, self.group, self.name, self.n = device, group, group.name, len(group.joints)
        self.to_model = np.array([device.joints.index(joint) for joint in group.joints])
        self.to_device = np.argsort(self.to_model)
