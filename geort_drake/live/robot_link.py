"""Connects a diagram to a robot."""

import math
import time
from collections.abc import Callable

import numpy as np
from pydrake.systems.framework import Context, DiscreteStateIndex, DiscreteValues, EventStatus, InputPort

from geort_drake.errors import LiveError
from geort_drake.live.glove_stream import POLL_PERIOD
from geort_drake.live.joint_messages import Bus, JointState, JointTargets
from geort_drake.live.transports import wait_for
from geort_drake.live.watchdog import AFTER
from geort_drake.simulation.following import JointGroup
from geort_drake.systems.python_system import PythonSystem

# Largest distance of a measured joint from its limits, rad; beyond it, the robot is not the model's.
_TOLERANCE = 0.1
# Number of periods without targets after which a driver holds.
_HOLD_PERIODS = 10


class RobotLink(PythonSystem):
    """Sends joint targets to a robot's driver and receives the robot's joint states, over any `Bus`.

    States are read every `POLL_PERIOD`. Targets are sent every `period`, as soon as they are computed. A
    robot without the model's arm is a hand alone: the arm stays in its initial position, and no targets are
    sent for it.

    Input ports:
        hand_desired_state (2n), arm_desired_state (2m): joint positions (rad), then velocities (rad/s), in
            the order of `hand` and `arm`.
        engaged (1): 1 while the robot follows the person, 0 while it holds.
    Output ports:
        hand_state (2n), arm_state (2m): measured positions (rad), then velocities (rad/s), in the same order;
            NaN before the first state.

    State: the values of the output ports.

    Attributes:
        bus: the bus, which counts what it refuses.

    Args:
        bus: where the driver listens.
        hand, arm: the model's joints.
        period: time between targets, s.
        clock: monotonic clock, s.
    """

    def __init__(
        self,
        bus: Bus[JointTargets, JointState],
        hand: JointGroup,
        arm: JointGroup,
        period: float,
        clock: Callable[[], float] = time.monotonic,
    ):
        super().__init__()
        self.bus, self._clock, self._hold_after = bus, clock, _HOLD_PERIODS * period
        self._measured: dict[str, tuple[float, float]] = {}  # joint → position, velocity
        self._arrived: dict[str, float] = {}
        self._sequence, self._fault = 0, ""
        self._groups = [hand, arm]
        self._ports = [self._declare_group(group) for group in self._groups]
        self._engaged = self.DeclareVectorInputPort("engaged", 1)
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(POLL_PERIOD, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(period, 2 * AFTER, self._publish)

    def handshake(self, timeout_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Waits for the robot's first states and checks that they fit the model.

        Returns:
            Positions of hand (n,) and arm (m,), rad, in the order of the ports, clamped to their limits.

        Raises:
            LiveError: no state of all joints came in time, or a joint is far outside its limits.
        """

        def poll() -> bool | None:
            self._fetch()
            return None if self._missing() else True

        wait_for(poll, timeout_s, lambda: self._silence(timeout_s))
        self._groups = [group for group, _, _ in self._ports if self._has(group)]
        return self._start(self._ports[0][0]), self._start(self._ports[1][0])

    def require_alive(self, silence_s: float) -> None:
        """Raises LiveError if a joint's state has not come for `silence_s`, s, or the robot has a fault."""
        if self._fault:
            raise LiveError(f"the robot reports a fault: {self._fault}; commands have stopped")
        for group in self._groups:
            name = min(group.joints, key=lambda name: self._arrived[name])
            if (silent := self._clock() - self._arrived[name]) > silence_s:
                raise LiveError(
                    f"{group.name}: no state of {name} for {silent:.1f} s; commands have stopped, because "
                    f"the robot may be elsewhere when it comes back{self._refusals()}"
                )

    def _has(self, group: JointGroup) -> bool:
        return bool(group.joints) and all(name in self._measured for name in group.joints)

    def _missing(self) -> list[str]:
        """Returns the joints that have no state yet: those of the hand, and of an arm if there is one."""
        hand, arm = (group for group, _, _ in self._ports)
        there = any(name in self._measured for name in arm.joints)
        wanted = [*hand.joints, *(arm.joints if there or self.bus.arm_is_required else [])]
        return [name for name in wanted if name not in self._measured]

    def _start(self, group: JointGroup) -> np.ndarray:
        if group not in self._groups:
            return group.start
        q = np.array([self._measured[name][0] for name in group.joints])
        clamped = np.clip(q, group.lower, group.upper)
        worst = int(np.argmax(np.abs(q - clamped)))
        if abs(q[worst] - clamped[worst]) > _TOLERANCE:
            raise LiveError(
                f"{group.name}: {group.joints[worst]} is at {q[worst]:.3f} rad, limits are "
                f"[{group.lower[worst]:.3f}, {group.upper[worst]:.3f}]. Is this the hand that the robot has?"
            )
        return clamped

    def _silence(self, timeout_s: float) -> str:
        missing = self._missing()
        others = sorted({*self._measured} - {name for group, _, _ in self._ports for name in group.joints})
        unknown = f"; it reports joints that the model has not: {', '.join(others)[:200]}" if others else ""
        names = ", ".join(missing[:4]) + (f" and {len(missing) - 4} more" if len(missing) > 4 else "")
        return f"no robot: no state of {names} within {timeout_s:g} s{unknown}{self._refusals()}"

    def _refusals(self) -> str:
        if not self.bus.refused:
            return ""
        return f"; {self.bus.refused} messages were refused, the last: {self.bus.last_refusal}"

    def _declare_group(self, group: JointGroup) -> tuple[JointGroup, InputPort, DiscreteStateIndex]:
        n = len(group.joints)
        port = self.DeclareVectorInputPort(f"{group.name}_desired_state", 2 * n)
        state = self.DeclareDiscreteState(np.full(2 * n, math.nan))
        self.DeclareVectorOutputPort(
            f"{group.name}_state",
            2 * n,
            lambda context, output: output.SetFromVector(context.get_discrete_state(state).value()),
            {self.discrete_state_ticket(state)},
        )
        return group, port, state

    def _fetch(self) -> None:
        for state in self.bus.fetch():
            for name, q, v in zip(state.names, state.position, state.velocity, strict=True):
                self._measured[name], self._arrived[name] = (float(q), float(v)), self._clock()
            self._fault = state.fault

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        self._fetch()
        for group, _, index in self._ports:
            resting = [(q, 0.0) for q in group.start]
            there = self._has(group)
            values = [self._measured[name] for name in group.joints] if there else resting
            if there or group not in self._groups:
                discrete_state.get_mutable_vector(index).SetFromVector(np.ravel(np.transpose(values)))
        return EventStatus.Succeeded()

    def _publish(self, context: Context) -> EventStatus:
        names: list[str] = []
        parts: list[np.ndarray] = []
        for group, port, _ in self._ports:
            if group in self._groups:
                names += group.joints
                parts.append(port.Eval(context).reshape(2, -1))
        position, velocity = np.concatenate(parts, axis=1)
        self._sequence += 1
        engaged = bool(self._engaged.Eval(context)[0] >= 0.5)
        self.bus.send(
            JointTargets(self._sequence, self._clock(), names, position, velocity, engaged, self._hold_after)
        )
        return EventStatus.Succeeded()
