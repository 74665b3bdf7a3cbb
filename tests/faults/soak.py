"""Very many updates of one system: whether its memory grows, and whether it slows down."""

import gc
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from system_bench import Bench, Watch

from faults.sound import play, smooth_retargeter
from geort_drake.systems.glove_checks import GloveChecks

BLOCKS = 100


def soak(count: int) -> dict[str, dict]:
    """Makes `count` updates of a `RetargetingSystem` and as many calls of a `Retargeter`.

    Returns:
        For each: updates; violations; us_per_update; growth_mb, growth of the resident memory after the first
        tenth; and slow_down, the median CPU time of an update in the last tenth over that in the second, less
        1.
    """
    bench, frames = Bench(checks=GloveChecks(ease_at_start=False)), play().p_HK.astype(float)
    watch, retarget = Watch(bench.limits, bench.period), smooth_retargeter()

    def update(number: int) -> int:
        q, v, _ = bench.tick(frames[number % len(frames)], float(number % 997 > 5))
        return len(watch.broken(q, v))

    def call(number: int) -> int:
        return int(not np.isfinite(retarget(frames[number % len(frames)]).sum()))

    return {"RetargetingSystem": _measured(update, count), "Retargeter": _measured(call, count)}


def _measured(step: Callable[[int], int], count: int) -> dict:
    """Calls `step`, which returns the violations of an update, with the update's number."""
    blocks = np.array_split(np.arange(count), min(BLOCKS, count))
    # The first tenth fills caches and pools.
    tenth = max(1, len(blocks) // 10)
    times, memory, violations = [], {}, 0
    for block, numbers in enumerate(blocks, 1):
        started = time.thread_time()
        for number in numbers.tolist():
            violations += step(number)
        times.append((time.thread_time() - started) / len(numbers))
        if block in (tenth, len(blocks)):
            gc.collect()
            memory[block] = _resident_mb()
    early, late = np.median(times[tenth : 2 * tenth] or times), np.median(times[-tenth:])
    return {
        "updates": count,
        "violations": violations,
        "growth_mb": round(max(0.0, memory[len(blocks)] - memory[tenth]), 2),
        "us_per_update": round(1e6 * float(np.median(times)), 1),
        "slow_down": round(float(late / early) - 1.0, 4),
    }


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
