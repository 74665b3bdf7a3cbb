"""Runs diagrams and recordings in real time: teleoperation with its engage key, and playback."""

import math
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from geort_drake.console import say
from geort_drake.live.messages import GloveFrame, encode_frame
from geort_drake.live.teleoperation import Teleoperation
from geort_drake.people.recording import Recording
from geort_drake.systems.retargeting_status import LIMITED, TRACKING

# At the end the robot is commanded to brake and hold for this long, s.
HOLD_S = 0.5
# A state is shown once it has lasted this long, s.
STEADY_S = 0.3
# How often keys, robot and state are checked, s.
STEP_S = 0.02
# A diagram that lags more than this, s, continues at the present time instead of catching up.
_MAX_LATENESS_S = 0.05


class SteadyState:
    """Passes on a state once it has lasted `STEADY_S`, so that people can read it."""

    def __init__(self) -> None:
        self._state = self._candidate = ""
        self._since = -math.inf

    def step(self, time: float, state: str) -> str:
        """Returns the state to show at `time`, s; the first one at once."""
        # A fast hand reaches its limits many times a second, and still follows.
        state = TRACKING if state == LIMITED else state
        if state != self._candidate:
            self._candidate, self._since = state, time
        if not self._state or time - self._since >= STEADY_S:
            self._state = state
        return self._state


class EnterKey:
    """Counts presses of Enter in the terminal, or newlines from a pipe.

    Args:
        stream: file descriptor to read without buffering; None for stdin.
    """

    def __init__(self, stream: int | None = None):
        self._stream = sys.stdin.fileno() if stream is None else stream
        self._ended = False

    def step(self, root: Context, engaged: bool) -> bool:
        """Toggles at each press; disengages at the end of the stream."""
        if self._ended or (presses := self.presses()) == 0:
            return engaged
        self._ended = presses is None
        return False if presses is None else engaged != (presses % 2 == 1)

    def presses(self) -> int | None:
        """Returns the presses since the last call, or None at the end of the stream; does not wait."""
        if not select.select([self._stream], [], [], 0.0)[0]:
            return 0
        # os.read returns half a line at once; readline would wait for its end.
        keys = os.read(self._stream, 4096)
        return keys.count(b"\n") if keys else None


def run_session(
    loop: Teleoperation,
    engaged: bool,
    control: Callable[[Context, bool], bool] | None,
    duration: float,
    stop: Callable[[], bool],
    require_robot: Callable[[], None],
    summary: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Runs the loop in real time until `stop()` or for `duration`, and then holds the robot.

    It prints the time and the state when that changes, see `SteadyState`, and notices of the glove's clock.

    Args:
        loop: the diagram of teleoperation.
        engaged: whether the person is engaged from the start.
        control: called at every step with the diagram's context and whether the person is engaged; returns
            whether to engage the person. None leaves it as it is.
        duration: longest duration, s.
        stop: returns whether to end the session.
        require_robot: called after every step; raises if the robot is lost.
        summary: summary of earlier sessions, to which this one is added.

    Returns:
        A summary in JSON types: `duration`, s; `states`, state → how long the fingers were in it, s; and
        `late`, how often the loop lagged and paused its simulated time.
    """
    simulator = Simulator(loop.diagram)
    root = simulator.get_mutable_context()
    if loop.stage is not None:
        loop.stage.initialize(root)
    loop.engage(root, engaged)
    simulator.Initialize()
    summary = summary or {"duration": 0.0, "states": {}, "late": 0}
    states = summary["states"]
    steady, last, notice = SteadyState(), "", ""
    end_time: float | None = None

    def go_on() -> bool:
        nonlocal engaged, last, notice, end_time
        time = root.get_time()
        if time > 0.0:
            require_robot()
        if control is not None and (request := control(root, engaged)) != engaged:
            engaged = request
            loop.engage(root, engaged and end_time is None)
        state = loop.state(root)
        kind = state.partition(";")[0]  # without the reason of a refusal
        states[kind] = round(states.get(kind, 0.0) + STEP_S, 6)
        if (steady_state := steady.step(time, state)) != last:
            say(f"{time:8.2f} s  {steady_state}")
            last = steady_state
        if loop.notice != notice:
            notice = loop.notice
            text = notice or "the glove's clock runs right again"
            say(f"{time:8.2f} s  {text}")
        if end_time is None and (stop() or time >= duration):
            end_time = time
            loop.engage(root, False)
        return end_time is None or time < end_time + HOLD_S

    summary["late"] += run_in_real_time(simulator, STEP_S, go_on)
    summary["duration"] += round(root.get_time(), 6)
    return summary


def run_in_real_time(
    simulator: Simulator,
    period: float,
    go_on: Callable[[], bool],
    clock: Callable[[], float] = time.monotonic,
) -> int:
    """Advances a simulator in steps of `period`, s, at the clock's speed, while `go_on()`.

    Returns:
        How often it lagged and paused its simulated time.
    """
    late = 0
    start = simulator.get_context().get_time()
    began, steps = clock(), 0
    simulator.set_target_realtime_rate(1.0)
    simulator.ResetStatistics()
    while go_on():
        steps += 1
        simulator.AdvanceTo(start + steps * period)
        if clock() - began - steps * period > _MAX_LATENESS_S:
            late += 1
            start, began, steps = simulator.get_context().get_time(), clock(), 0
            simulator.ResetStatistics()
    return late


def play(
    recording: Recording,
    send: Callable[[bytes], None],
    stop: threading.Event,
    clock: Callable[[], float] = time.monotonic,
) -> int:
    """Sends a recording's frames when they are due, as a glove does, until its end or until `stop` is set.

    Messages carry the time of sending, so that late frames do not appear punctual.

    Returns:
        The number of frames sent.
    """
    start = clock()
    count = 0
    for i, t in enumerate(recording.t - recording.t[:1]):
        if stop.wait(max(start + t - clock(), 0.0)):
            break
        p_HK = recording.p_HK[i] if recording.valid[i] else None
        X_WH = None if recording.X_WH is None else recording.X_WH[i]
        send(encode_frame(GloveFrame(recording.side, clock(), p_HK, X_WH)))
        count += 1
    return count


@contextmanager
def stopping() -> Iterator[threading.Event]:
    """Yields an event that Ctrl-C or SIGTERM sets; a second Ctrl-C interrupts as usual."""
    event = threading.Event()
    handlers: dict[int, Any] = {}

    def stop(number: int, _frame: object) -> None:
        event.set()
        signal.signal(number, handlers[number])

    for number in (signal.SIGINT, signal.SIGTERM):
        handlers[number] = signal.signal(number, stop)
    try:
        yield event
    finally:
        for signum, handler in handlers.items():
            signal.signal(signum, handler)
