"""Connects the motors of a real hand to `geort-drake live`: the loop of a driver.

    with JointDriver("tcp://127.0.0.1:5557", names, q, lower, upper, speed) as driver:
        while driver.running:
            hand.write(driver.step(hand.read()))

It needs NumPy, pyzmq and msgspec only. `examples/drivers/` has drivers for several hands.
"""

import math
import signal
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any

import numpy as np

from geort_drake.errors import LiveError
from geort_drake.live.joint_messages import JointState, JointTargets, open_driver_bus

FIRST_SPEED = 0.1  # fraction of the full speed for first motions


class JointDriver:
    """Follows joint targets within limits, and holds when they stop.

    It moves from where the robot stands towards the newest targets, at most at `speed`. It holds its last
    command before the first targets, when the newest ones are older than their `hold_after`, and while a
    measured position is not finite. Such a measurement is not reported, so `geort-drake live` ends when they
    last as long as it tolerates silence.

    Attributes:
        running: whether to go on; Ctrl-C and SIGTERM end it, after which the loop should leave the motors
            holding or limp, whichever is safe for the hand.
        holding: whether the robot holds because targets are missing.
        bus: the connection, which counts the messages that it refuses.

    Args:
        endpoint: ZeroMQ endpoint of `geort-drake live --robot zmq+ENDPOINT`.
        names: names of the n joints, as in the hand's model.
        position: (n,) where the joints stand, rad.
        lower, upper: (n,) or scalar position limits, rad, infinite where there are none; a robot that stands
            outside of them moves back at `speed` when it follows targets.
        speed: (n,) or scalar speed limit, rad/s.
        rate: steps per second; `step` waits for the next one.
        clock, sleep: monotonic clock, s, and function that waits.

    Raises:
        LiveError: a name occurs twice; a number is not finite, or not one per joint; a lower limit is above
            the upper one; the speed or rate is not positive; or the endpoint is malformed.
    """

    def __init__(
        self,
        endpoint: str,
        names: Sequence[str],
        position: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        speed: np.ndarray | float,
        rate: float = 100.0,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ):
        self.names = list(names)
        if len({*self.names}) != len(self.names):
            raise LiveError(f"driver: a name occurs twice in names: {', '.join(self.names)[:80]}")
        self._command = self._per_joint("position", position)
        self._lower, self._upper = self._per_joint("lower", lower), self._per_joint("upper", upper)
        self._speed = self._per_joint("speed", speed)
        for name, low, high, fastest in zip(self.names, self._lower, self._upper, self._speed, strict=True):
            if low > high:
                raise LiveError(f"driver: lower limit {low:g} of joint '{name}' is above upper {high:g} rad")
            if fastest <= 0.0:
                raise LiveError(f"driver: speed of joint '{name}' must be positive, not {fastest:g} rad/s")
        if not 0.0 < rate < math.inf:
            raise LiveError(f"driver: rate must be positive, not {rate:g} Hz")
        self._period = 1.0 / rate
        self._clock, self._sleep = clock, sleep
        self.bus = open_driver_bus(endpoint)
        self.running, self.holding = True, True
        self._newest: JointTargets | None = None
        self._arrival = self._next = clock()
        self._measured: tuple[float, np.ndarray] | None = None
        self._sequence = 0

    def __enter__(self) -> "JointDriver":
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._stop)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.bus.close()

    def step(self, position: np.ndarray, fault: str = "") -> np.ndarray:
        """Reports where the robot is, waits for the next period, and returns the joint targets (n,), rad.

        Args:
            position: (n,) measured joint positions, rad.
            fault: what is wrong with the robot, or ""; a robot with a fault is held.

        Raises:
            LiveError: there is not one position per joint.
        """
        now = self._clock()
        position = np.asarray(position, float)
        if position.shape != self._command.shape:
            raise LiveError(f"driver: {len(self.names)} measured positions are needed, not {position.shape}")
        readable = bool(np.isfinite(position).all())
        if readable or fault:
            self._report(now, position if readable else self._command, fault)
        self._next = max(self._next + self._period, now)
        self._sleep(max(self._next - now, 0.0))
        if messages := self.bus.fetch():
            self._newest, self._arrival = messages[-1], self._clock()
        targets = self._newest
        is_late = targets is not None and self._clock() - self._arrival > targets.hold_after
        self.holding = targets is None or is_late or bool(fault) or not readable
        if targets is not None and not self.holding:
            positions = dict(zip(targets.names, targets.position, strict=True))
            goal = np.array(
                [positions.get(name, q) for name, q in zip(self.names, self._command, strict=True)]
            )
            step = self._speed * self._period
            goal = np.clip(goal, self._lower, self._upper)
            self._command = self._command + np.clip(goal - self._command, -step, step)
        return self._command.copy()

    def _per_joint(self, name: str, value: np.ndarray | float) -> np.ndarray:
        """Returns an argument as numbers (n,); a single limit or speed is that of all joints."""
        array = np.asarray(value, float)
        if array.ndim == 0 and name != "position":
            array = np.full(len(self.names), float(array))
        if array.shape != (len(self.names),):
            raise LiveError(f"driver: {name} must be {len(self.names)} numbers, not of shape {array.shape}")
        for joint, number in zip(self.names, array, strict=True):
            is_unlimited = np.isinf(number) and name in ("lower", "upper")
            if not (np.isfinite(number) or is_unlimited):
                raise LiveError(f"driver: {name} of joint '{joint}' must be finite, not {number}")
        return array.copy()

    def _stop(self, *_: Any) -> None:
        self.running = False

    def _report(self, now: float, position: np.ndarray, fault: str) -> None:
        velocity = np.zeros_like(position)
        if self._measured is not None and now > self._measured[0]:
            velocity = (position - self._measured[1]) / (now - self._measured[0])
        self._measured = now, position
        self._sequence += 1
        self.bus.send(
            JointState(self._sequence, now, self.names, position.tolist(), velocity.tolist(), fault)
        )
