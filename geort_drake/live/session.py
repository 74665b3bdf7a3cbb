"""One session of teleoperation: engage, run in real time, and leave the robot held."""

import dataclasses as dc
import os
import select
import sys
import threading
from collections.abc import Callable

from pydrake.systems.analysis import Simulator

from geort_drake.live.real_time import run_in_real_time
from geort_drake.live.teleoperation import Teleoperation
from geort_drake.systems.retargeting_system import LIMITED, TRACKING

# After the end the robot is sent a braking hand, and where it stopped, for so long, s.
HOLD_S = 0.5
# How often keys, the robot and the state are looked at, s.
_STEP_S = 0.02


@dc.dataclass(frozen=True)
class SessionReport:
    """What came of a session.

    Attributes:
        duration: s.
        states: how long the fingers were in each, s.
        late: how often the loop could not keep up, so that its time stood still for a moment.
    """

    duration: float
    states: dict[str, float]
    late: int


class EnterKey:
    """How often Enter was pressed in the terminal, or newlines came through a pipe.

    Args:
        stream: the file descriptor that is read, past any buffer.
    """

    def __init__(self, stream: int | None = None):
        self._stream = sys.stdin.fileno() if stream is None else stream

    def presses(self) -> int | None:
        """How often since the last call; None once there will be no more keys. Does not wait."""
        if not select.select([self._stream], [], [], 0.0)[0]:
            return 0
        # What is there, also half a line, which readline() would wait for the end of.
        keys = os.read(self._stream, 4096)
        return keys.count(b"\n") if keys else None


def run_session(
    loop: Teleoperation,
    engaged: bool,
    key: EnterKey | None,
    duration: float,
    stop: threading.Event,
    require_robot: Callable[[], None] = lambda: None,
    tell: Callable[[float, str], None] = lambda time, state: None,
) -> SessionReport:
    """Runs the loop in real time until `stop` is set or the time is up, and then holds.

    Args:
        engaged: whether from the start.
        key: toggles it; where no more keys can come, the person is disengaged. None: no keys.
        duration: s.
        require_robot: called after every step; raises where the robot is lost.
        tell: called with the time (s) and the state whenever it changes; a limit counts as tracking.
    """
    simulator = Simulator(loop.diagram)
    root = simulator.get_mutable_context()
    loop.initialize(root)
    loop.engage(root, engaged)
    simulator.Initialize()
    states: dict[str, float] = {}
    last = ""
    ended: float | None = None

    def going_on() -> bool:
        nonlocal engaged, key, last, ended
        time = root.get_time()
        if time > 0.0:
            require_robot()
        if key is not None and (presses := key.presses()) != 0:
            engaged = engaged != (presses % 2 == 1) if presses else False
            key = key if presses else None
            loop.engage(root, engaged and ended is None)
        state = loop.state(root)
        states[state] = states.get(state, 0.0) + _STEP_S
        # A quick hand is at its limits many times a second, which is no news.
        news = TRACKING if state == LIMITED else state
        if news != last:
            tell(time, news)
            last = news
        if ended is None and (stop.is_set() or time >= duration):
            ended = time
            loop.engage(root, False)
        return ended is None or time < ended + HOLD_S

    late = run_in_real_time(simulator, _STEP_S, going_on)
    return SessionReport(round(root.get_time(), 6), {k: round(v, 6) for k, v in states.items()}, late)
