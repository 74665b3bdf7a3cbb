"""Connects the motors of a real hand to `geort-drake live`: the loop of a driver.

    with JointDriver("tcp://127.0.0.1:5557", names, q, lower, upper, speed) as driver:
        while driver.running:
            hand.write(driver.step(hand.read()))

It needs NumPy and pyzmq only. `examples/drivers/` has drivers for several hands.
"""

import signal
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any

import numpy as np

from geort_drake.errors import LiveError
from geort_drake.live.joint_messages import JointState, JointTargets, decode_targets, encode

FIRST_SPEED = 0.1  # fraction of the full speed for first motions


def status_endpoint(endpoint: str) -> str:
    """Returns the endpoint at which states are received: the next TCP port, or the path with `-state`."""
    if endpoint.startswith("tcp://"):
        host, _, port = endpoint.rpartition(":")
        return f"{host}:{int(port) + 1}"
    return f"{endpoint}-state"


class JointDriver:
    """Follows joint targets within limits, and holds when they stop.

    It moves from where the robot stands towards the newest targets, at most at `speed`. It holds its last
    command before the first targets, and when the newest ones are older than their `hold_after`.

    Attributes:
        running: whether to go on; Ctrl-C and SIGTERM end it, after which the loop should leave the motors
            holding or limp, whichever is safe for the hand.
        holding: whether the robot holds because targets are missing.
        refused, last_refusal: number of messages that could not be used, and why the last could not.

    Args:
        endpoint: ZeroMQ endpoint of `geort-drake live --robot zmq+ENDPOINT`.
        names: names of the n joints, as in the hand's model.
        position: (n,) where the joints stand, rad.
        lower, upper: (n,) position limits, rad.
        speed: (n,) or scalar speed limit, rad/s.
        rate: steps per second; `step` waits for the next one.
        clock, sleep: monotonic clock, s, and function that waits.
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
        import zmq

        self.names, self._command = list(names), np.clip(np.asarray(position, float), lower, upper)
        self._lower, self._upper = np.asarray(lower, float), np.asarray(upper, float)
        self._speed, self._period, self._clock, self._sleep = (
            np.asarray(speed, float),
            1.0 / rate,
            clock,
            sleep,
        )
        self._zmq, self._context = zmq, zmq.Context()
        self._targets = self._context.socket(zmq.SUB)
        self._targets.setsockopt(zmq.SUBSCRIBE, b"")
        self._targets.setsockopt(zmq.LINGER, 0)
        self._targets.connect(endpoint)
        self._states = self._context.socket(zmq.PUSH)
        self._states.setsockopt(zmq.SNDHWM, 2)
        self._states.setsockopt(zmq.LINGER, 0)
        self._states.connect(status_endpoint(endpoint))
        self.running, self.holding = True, True
        self.refused, self.last_refusal = 0, ""
        self._newest: JointTargets | None = None
        self._arrived = self._next = clock()
        self._measured: tuple[float, np.ndarray] | None = None
        self._sequence = 0

    def __enter__(self) -> "JointDriver":
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._stop)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._context.destroy(linger=0)

    def step(self, position: np.ndarray, fault: str = "") -> np.ndarray:
        """Reports where the robot is, waits for the next period, and returns the joint targets (n,), rad.

        Args:
            position: (n,) measured joint positions, rad.
            fault: what is wrong with the robot, or ""; a robot with a fault is held.
        """
        now = self._clock()
        self._report(now, np.asarray(position, float), fault)
        self._next = max(self._next + self._period, now)
        self._sleep(max(self._next - now, 0.0))
        self._receive()
        targets = self._newest
        self.holding = targets is None or bool(fault) or self._clock() - self._arrived > targets.hold_after
        if targets is not None and not self.holding:
            wanted = dict(zip(targets.names, targets.position, strict=True))
            goal = np.array([wanted.get(name, q) for name, q in zip(self.names, self._command, strict=True)])
            step = self._speed * self._period
            goal = np.clip(goal, self._lower, self._upper)
            self._command = self._command + np.clip(goal - self._command, -step, step)
        return self._command.copy()

    def _stop(self, *_: Any) -> None:
        self.running = False

    def _receive(self) -> None:
        while True:
            try:
                message = self._targets.recv(self._zmq.NOBLOCK)
            except self._zmq.Again:
                return
            try:
                self._newest, self._arrived = decode_targets(message), self._clock()
            except LiveError as error:
                self.refused, self.last_refusal = self.refused + 1, str(error)

    def _report(self, now: float, position: np.ndarray, fault: str) -> None:
        velocity = np.zeros_like(position)
        if self._measured is not None and now > self._measured[0]:
            velocity = (position - self._measured[1]) / (now - self._measured[0])
        self._measured = now, position
        self._sequence += 1
        state = JointState(self._sequence, now, self.names, position, velocity, fault)
        try:
            self._states.send(encode(state), self._zmq.NOBLOCK)
        except self._zmq.Again:
            pass  # nobody listens
