"""How long a hand's motion takes to the robot's command, and to the robot's word that it follows it."""

import dataclasses as dc
import math
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from geort_drake.live.glove_stream import POLL_PERIOD
from geort_drake.live.watchdog import AFTER

_MOST_KEPT = 100_000
_MOST_UNDERWAY = 1_000


@dc.dataclass(frozen=True)
class Latency:
    """Of `count` samples, s; None where there is none."""

    count: int
    median: float | None
    p99: float | None

    @classmethod
    def of(cls, samples: Sequence[float]) -> "Latency":
        """Median and 99th percentile."""
        if not len(samples):
            return cls(0, None, None)
        median, p99 = np.percentile(samples, [50, 99])
        return cls(len(samples), float(median), float(p99))


class LatencyMeter(LeafSystem):
    """Measures with this machine's clock how long commands and their echoes take.

    A sample is taken of the first command after new keypoints, if it differs from the one before: from when
    they were measured to when it goes out, and to when the robot's status names it, to the last bit.

    Input ports:
        sent (1): when the newest keypoints were measured, s, on the clock; NaN before the first.
        command (2n): joint positions, then velocities, as they go out.
        echo (n), need not be connected: the positions that the robot says it follows.

    Args:
        num_joints: n.
        period: of the commands, s.
        clock: that of `sent`.
    """

    def __init__(self, num_joints: int, period: float, clock: Callable[[], float] = time.monotonic):
        super().__init__()
        self._n, self._clock = num_joints, clock
        self._to_command: deque[float] = deque(maxlen=_MOST_KEPT)
        self._to_echo: deque[float] = deque(maxlen=_MOST_KEPT)
        self._last_sent, self._last_command = math.nan, b""
        self._underway: OrderedDict[bytes, float] = OrderedDict()
        self._sent = self.DeclareVectorInputPort("sent", 1)
        self._command = self.DeclareVectorInputPort("command", 2 * num_joints)
        self._echo = self.DeclareVectorInputPort("echo", num_joints)
        self.DeclarePeriodicPublishEvent(period, 2 * AFTER, self._goes_out)
        self.DeclarePeriodicPublishEvent(POLL_PERIOD, 2 * AFTER, self._comes_back)

    def to_command(self) -> Latency:
        """From the keypoints to the command."""
        return Latency.of(self._to_command)

    def to_echo(self) -> Latency:
        """From the keypoints to the robot's status that names the command."""
        return Latency.of(self._to_echo)

    def _goes_out(self, context: Context) -> EventStatus:
        sent = float(self._sent.Eval(context)[0])
        key = self._command.Eval(context)[: self._n].tobytes()
        if math.isfinite(sent) and sent != self._last_sent and key != self._last_command:
            self._to_command.append(self._clock() - sent)
            self._underway[key] = sent
            while len(self._underway) > _MOST_UNDERWAY:
                self._underway.popitem(last=False)
        self._last_sent, self._last_command = sent, key
        return EventStatus.Succeeded()

    def _comes_back(self, context: Context) -> EventStatus:
        if self._echo.HasValue(context):
            sent = self._underway.pop(self._echo.Eval(context).tobytes(), None)
            if sent is not None:
                self._to_echo.append(self._clock() - sent)
        return EventStatus.Succeeded()
