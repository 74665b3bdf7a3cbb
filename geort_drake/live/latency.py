"""Measures the time from a hand's motion to the robot's command and to the status that confirms it."""

import dataclasses as dc
import math
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.systems.framework import Context, EventStatus

from geort_drake.live.glove_stream import POLL_PERIOD
from geort_drake.live.watchdog import AFTER
from geort_drake.systems.python_system import PythonSystem

_MAX_SAMPLES = 100_000
_MAX_UNCONFIRMED = 1_000


@dc.dataclass(frozen=True)
class Latency:
    """Median and 99th percentile of `count` samples, s; None without samples."""

    count: int
    median: float | None
    p99: float | None

    @classmethod
    def of(cls, samples: Sequence[float] | np.ndarray) -> "Latency":
        """Returns the statistics of samples, s."""
        if not len(samples):
            return cls(0, None, None)
        median, p99 = np.percentile(samples, [50, 99])
        return cls(len(samples), float(median), float(p99))


class _Samples:
    """The newest samples, s, in memory of constant size, so that a long session does not grow."""

    def __init__(self) -> None:
        self._values, self._count = np.full(_MAX_SAMPLES, math.nan), 0

    def append(self, value: float) -> None:
        self._values[self._count % _MAX_SAMPLES] = value
        self._count += 1

    def newest(self, number: int = _MAX_SAMPLES) -> np.ndarray:
        """Returns at most `number` of them."""
        number = min(number, self._count, _MAX_SAMPLES)
        return self._values[np.arange(self._count - number, self._count) % _MAX_SAMPLES]


class LatencyMeter(PythonSystem):
    """Measures how long commands and their confirmations take, on this machine's clock.

    It takes a sample for the first command after new keypoints, if that differs from the command before it.

    Input ports:
        sent (1): when the newest keypoints were measured, s, on `clock`; NaN before the first.
        command (2n): joint positions (rad), then velocities (rad/s), as sent.
        echo (n), optional: commanded positions that the robot reports, rad.

    Args:
        num_joints: n.
        period: time between commands, s.
        clock: clock of `sent`, s.
    """

    def __init__(self, num_joints: int, period: float, clock: Callable[[], float] = time.monotonic):
        super().__init__()
        self._n, self._clock = num_joints, clock
        self._to_command, self._to_echo = _Samples(), _Samples()
        self._last_sent, self._last_command = math.nan, b""
        # The bytes of a command's positions → when its keypoints were measured.
        self._unconfirmed: OrderedDict[bytes, float] = OrderedDict()
        self._sent = self.DeclareVectorInputPort("sent", 1)
        self._command = self.DeclareVectorInputPort("command", 2 * num_joints)
        self._echo = self.DeclareVectorInputPort("echo", num_joints)
        self.DeclarePeriodicPublishEvent(period, 2 * AFTER, self._note_command)
        self.DeclarePeriodicPublishEvent(POLL_PERIOD, 2 * AFTER, self._note_echo)

    def to_command(self, newest: int = _MAX_SAMPLES) -> Latency:
        """Returns the time from keypoints to command, over the `newest` samples."""
        return Latency.of(self._to_command.newest(newest))

    def to_echo(self) -> Latency:
        """Returns the time from keypoints to the robot's status that reports the command."""
        return Latency.of(self._to_echo.newest())

    def _note_command(self, context: Context) -> EventStatus:
        sent = float(self._sent.Eval(context)[0])
        key = self._command.Eval(context)[: self._n].tobytes()
        if math.isfinite(sent) and sent != self._last_sent and key != self._last_command:
            self._to_command.append(self._clock() - sent)
            self._unconfirmed[key] = sent
            while len(self._unconfirmed) > _MAX_UNCONFIRMED:
                self._unconfirmed.popitem(last=False)
        self._last_sent, self._last_command = sent, key
        return EventStatus.Succeeded()

    def _note_echo(self, context: Context) -> EventStatus:
        if self._echo.HasValue(context):
            sent = self._unconfirmed.pop(self._echo.Eval(context).tobytes(), None)
            if sent is not None:
                self._to_echo.append(self._clock() - sent)
        return EventStatus.Succeeded()
