"""Measures the delay of the person's control: from keypoints to the joint targets computed from them."""

import math
import time
from collections import deque
from collections.abc import Callable

import numpy as np
from pydrake.systems.framework import Context, EventStatus

from geort_drake.live.watchdog import AFTER
from geort_drake.systems.python_system import PythonSystem

_MAX_SAMPLES = 3_000


class DelayMeter(PythonSystem):
    """Measures how long joint targets take, on this machine's clock.

    It takes a sample for the first command after new keypoints, if that differs from the command before it,
    and keeps the newest 3,000 samples.

    Input ports:
        sent (1): when the newest keypoints were measured, s, on `clock`; NaN before the first.
        command (2n): joint positions (rad), then velocities (rad/s), as sent to the robot.

    Args:
        num_joints: n.
        period: time between commands, s.
        clock: clock of `sent`, s.
    """

    def __init__(self, num_joints: int, period: float, clock: Callable[[], float] = time.monotonic):
        super().__init__()
        self._n, self._clock = num_joints, clock
        self._samples: deque[float] = deque(maxlen=_MAX_SAMPLES)
        self._last_sent, self._last_command = math.nan, np.full(num_joints, math.nan)
        self._sent = self.DeclareVectorInputPort("sent", 1)
        self._command = self.DeclareVectorInputPort("command", 2 * num_joints)
        self.DeclarePeriodicPublishEvent(period, 2 * AFTER, self._sample)

    def delay(self, newest: int = _MAX_SAMPLES) -> dict[str, float | int | None]:
        """Returns `count`, `median` and `p99` (s) of the newest samples; None without samples."""
        samples = list(self._samples)[-newest:]
        if not samples:
            return {"count": 0, "median": None, "p99": None}
        median, p99 = np.percentile(samples, [50, 99]).tolist()
        return {"count": len(samples), "median": median, "p99": p99}

    def _sample(self, context: Context) -> EventStatus:
        sent, q = float(self._sent.Eval(context)[0]), self._command.Eval(context)[: self._n].copy()
        changed = not np.array_equal(q, self._last_command)
        if math.isfinite(sent) and sent != self._last_sent and changed:
            self._samples.append(self._clock() - sent)
        self._last_sent, self._last_command = sent, q
        return EventStatus.Succeeded()
