"""Very many updates of one system: whether it grows, and whether it slows down."""

import gc
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from faults.bench import Bench, Watch
from faults.sound import play, smooth_retargeter
from geort_drake.systems.glove_checks import GloveChecks

BLOCKS = 100


def soak(count: int) -> dict[str, dict]:
    """`count` updates of a `RetargetingSystem` and as many calls of a `Retargeter`.

    Returns:
        For each: updates; violations; growth_mb, of resident memory after the first tenth; and slow_down,
        the median CPU time of an update in the last tenth over that in the first but one, less 1.
    """
    return {"RetargetingSystem": _system(count), "Retargeter": _call(count)}


def _system(count: int) -> dict:
    bench = Bench(checks=GloveChecks(ease_at_start=False))
    watch, frames = Watch(bench.limits, bench.period), play().p_HK.astype(float)
    number = violations = 0

    def update() -> None:
        nonlocal number, violations
        q, v, _ = bench.tick(frames[number % len(frames)], float(number % 997 > 5))
        violations += len(watch.broken(q, v))
        number += 1

    return _measured(update, count) | {"violations": violations}


def _call(count: int) -> dict:
    retarget, frames = smooth_retargeter(), play().p_HK.astype(float)
    number = violations = 0

    def call() -> None:
        nonlocal number, violations
        q = retarget(frames[number % len(frames)])
        violations += not np.isfinite(q.sum())
        number += 1

    return _measured(call, count) | {"violations": violations}


def _measured(update: Callable[[], None], count: int) -> dict:
    blocks = min(BLOCKS, count)
    # The first tenth fills caches and pools.
    tenth = max(1, blocks // 10)
    times, memory = [], {}
    for block in range(blocks):
        steps = count * (block + 1) // blocks - count * block // blocks
        started = time.thread_time()
        for _ in range(steps):
            update()
        times.append((time.thread_time() - started) / steps)
        if block + 1 in (tenth, blocks):
            gc.collect()
            memory[block + 1] = _resident_mb()
    early, late = np.median(times[tenth : 2 * tenth] or times), np.median(times[-tenth:])
    return {
        "updates": count,
        "growth_mb": round(max(0.0, memory[blocks] - memory[tenth]), 2),
        "us_per_update": round(1e6 * float(np.median(times)), 1),
        "slow_down": round(float(late / early) - 1.0, 4),
    }


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
