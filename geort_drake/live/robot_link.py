"""Connects a diagram to a robot on LCM."""

import dataclasses as dc
import math
import time
from collections.abc import Callable

import numpy as np
from pydrake.systems.framework import Context, DiscreteStateIndex, DiscreteValues, EventStatus, InputPort

from geort_drake.errors import LiveError
from geort_drake.live.devices import ALLEGRO, PANDA, Device, JointGroup, LcmInbox
from geort_drake.live.glove_stream import POLL_PERIOD
from geort_drake.live.transports import open_lcm, wait_for
from geort_drake.live.watchdog import AFTER
from geort_drake.systems.python_system import PythonSystem

# Largest distance of a measured joint from its limits, rad; beyond it, the robot is not the model's.
_TOLERANCE = 0.1


class RobotLink(PythonSystem):
    """Sends joint positions to an Allegro hand and a Panda arm over LCM, and receives their joint states.

    The messages are Drake's `lcmt_allegro_*` and `lcmt_panda_*`. Statuses are read every `POLL_PERIOD`.
    Commands are sent every `period`, as soon as they are computed.

    Input ports:
        hand_desired_state (32), arm_desired_state (14): joint positions (rad), which are sent, then
            velocities (rad/s), which are not, in the order of `hand` and `arm`.
    Output ports:
        hand_state (32), arm_state (14): measured positions (rad), then velocities (rad/s), in the same order.
        hand_commanded (16): commanded positions that the hand reports, rad, in the order of `hand`.
        All are NaN before the first status.

    State: the values of the output ports, and the arm's reported command (7).

    Attributes:
        inbox: newest statuses, and the number of statuses that could not be used.

    Args:
        url: URL of the LCM bus.
        hand, arm: the model's joints.
        period: time between commands, s.
        clock: monotonic clock, s.

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
        self._parts = [self._declare_part(ALLEGRO, hand), self._declare_part(PANDA, arm)]
        n = len(hand.joints)
        self._declare_output("hand_commanded", self._parts[0].state, slice(2 * n, 3 * n))
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(POLL_PERIOD, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(period, 2 * AFTER, self._publish)

    def handshake(self, timeout_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Waits for the robot's first statuses and checks that they fit the model.

        Returns:
            Positions of hand (16,) and arm (7,), rad, in the order of the ports, clamped to their limits.

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
            q = self.inbox.newest[part.device.status_channel].position[part.to_model]
            clamped = np.clip(q, lower, upper)
            worst = int(np.argmax(np.abs(q - clamped)))
            if abs(q[worst] - clamped[worst]) > _TOLERANCE:
                raise LiveError(
                    f"{part.device.name}: {part.group.joints[worst]} is at {q[worst]:.3f} rad, limits are "
                    f"[{lower[worst]:.3f}, {upper[worst]:.3f}]. Is this the hand that the robot has?"
                )
            positions.append(clamped)
        return positions[0], positions[1]

    def require_alive(self, silence_s: float) -> None:
        """Raises LiveError if hand or arm has sent no usable status for `silence_s`, s."""
        for device in (ALLEGRO, PANDA):
            silent = self._clock() - self.inbox.arrived[device.status_channel]
            if silent > silence_s:
                raise LiveError(
                    f"{device.name}: no {device.status_channel} for {silent:.1f} s; commands have stopped, "
                    f"because the robot may be elsewhere when it comes back{self._refusals()}"
                )

    def _silence(self, timeout_s: float) -> str:
        channels = (part.device.status_channel for part in self._parts)
        missing = " and ".join(channel for channel in channels if channel not in self.inbox.newest)
        return f"no robot: {missing} did not come within {timeout_s:g} s{self._refusals()}"

    def _refusals(self) -> str:
        if not self.inbox.refused:
            return ""
        return f"; {self.inbox.refused} messages were refused, the last: {self.inbox.last_refusal}"

    def _declare_part(self, device: Device, group: JointGroup) -> "_Part":
        n, to_model = len(group.joints), device.model_order(group)
        port = self.DeclareVectorInputPort(f"{group.name}_desired_state", 2 * n)
        # Positions, velocities, commanded positions.
        state = self.DeclareDiscreteState(np.full(3 * n, math.nan))
        self._declare_output(f"{group.name}_state", state, slice(0, 2 * n))
        return _Part(device, group, to_model, port, state)

    def _declare_output(self, name: str, state: DiscreteStateIndex, values: slice) -> None:
        self.DeclareVectorOutputPort(
            name,
            values.stop - values.start,
            lambda context, output: output.SetFromVector(context.get_discrete_state(state).value()[values]),
            {self.discrete_state_ticket(state)},
        )

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        self.inbox.fetch()
        for part in self._parts:
            if (status := self.inbox.newest.get(part.device.status_channel)) is not None:
                values = (status.position, status.velocity, status.commanded)
                discrete_state.get_mutable_vector(part.state).SetFromVector(
                    np.concatenate([v[part.to_model] for v in values])
                )
        return EventStatus.Succeeded()

    def _publish(self, context: Context) -> EventStatus:
        for part in self._parts:
            q = part.desired.Eval(context)[: len(part.to_model)]
            message = part.device.encode_command(self._clock(), q[np.argsort(part.to_model)])
            self._lcm.Publish(part.device.command_channel, message)
        return EventStatus.Succeeded()


@dc.dataclass(frozen=True, eq=False)
class _Part:
    """A device, the model's joints that it moves, and its port and state."""

    device: Device
    group: JointGroup
    to_model: np.ndarray
    desired: InputPort
    state: DiscreteStateIndex
