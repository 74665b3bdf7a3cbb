"""Simulating a diagram in real time until someone stops it."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from pydrake.systems.analysis import Simulator

# A diagram that is later than this does not hurry to catch up, s: its time goes on from where it is.
_LATEST_S = 0.05


def run_in_real_time(
    simulator: Simulator,
    period: float,
    going_on: Callable[[], bool],
    clock: Callable[[], float] = time.monotonic,
) -> int:
    """Advances by `period` (s) at a time, as fast as the clock goes, while `going_on()`.

    Returns:
        How often it was late, so that its time stood still for a moment.
    """
    late = 0
    start = simulator.get_context().get_time()
    began, steps = clock(), 0
    simulator.set_target_realtime_rate(1.0)
    simulator.ResetStatistics()
    while going_on():
        steps += 1
        simulator.AdvanceTo(start + steps * period)
        if clock() - began - steps * period > _LATEST_S:
            late += 1
            start, began, steps = simulator.get_context().get_time(), clock(), 0
            simulator.ResetStatistics()
    return late


@contextmanager
def stopping() -> Iterator[threading.Event]:
    """An event that Ctrl-C or a request to terminate sets; a second Ctrl-C interrupts as usual."""
    event = threading.Event()
    before: dict[int, Any] = {}

    def stop(number: int, _frame: object) -> None:
        event.set()
        signal.signal(number, before[number])

    for number in (signal.SIGINT, signal.SIGTERM):
        before[number] = signal.signal(number, stop)
    try:
        yield event
    finally:
        for kept, handler in before.items():
            signal.signal(kept, handler)
