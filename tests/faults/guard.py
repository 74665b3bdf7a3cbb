"""Commands that fold the hand into itself, through the guard."""

import time
from collections import Counter
from collections.abc import Callable

import numpy as np

from geort_drake import HandModel, load_hand
from geort_drake.hands.clearance import HandClearance
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.self_collision_guard import SelfCollisionGuard

PERIOD, CLEARANCE = 0.01, 0.002
# Lower and upper limits and a generator → commanded positions (n,), rad.
COMMANDS: dict[str, Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]] = {
    "anywhere": lambda low, high, rng: rng.uniform(low, high),
    "at the limits": lambda low, high, rng: np.where(rng.random(len(low)) < 0.5, low, high),
    "beyond them": lambda low, high, rng: rng.normal(0.0, 20.0, len(low)),
    "huge": lambda low, high, rng: rng.choice([-1e300, 1e300], len(low)),
    "not finite": lambda low, high, rng: np.where(rng.random(len(low)) < 0.2, np.nan, np.inf),
}


def fuzz_guard(count: int, seed: int) -> dict:
    """Gives the guard of an Allegro hand `count` commands, each repeated for one to 40 steps.

    Returns:
        steps, how many had which kind of command, how many of these were corrected, how often which guarantee
        was broken, and the median times, µs, of steps that passed a finite command on or corrected it.
    """
    rng = np.random.default_rng(seed)
    hand = HandModel(load_hand("allegro_right"))
    limits = JointLimits(hand.lower, hand.upper)
    start = dict(zip(hand.joint_names, hand.default_position, strict=True))
    guard = SelfCollisionGuard(hand, hand.joint_names, start, limits, PERIOD, CLEARANCE)
    judge = HandClearance(hand, CLEARANCE)
    reach = limits.speed * PERIOD
    q, left, wanted = hand.default_position, 0, hand.default_position
    kinds: Counter[str] = Counter()
    broken: Counter[str] = Counter()
    kinds_corrected: Counter[str] = Counter()
    times: dict[bool, list[float]] = {False: [], True: []}
    kind = ""
    for _ in range(count):
        if left == 0:
            kind, left = str(rng.choice(list(COMMANDS))), int(rng.integers(1, 41))
            wanted = COMMANDS[kind](hand.lower, hand.upper, rng)
        left -= 1
        kinds[kind] += 1
        before = q
        started = time.perf_counter()
        q = guard.guarded(wanted, before)
        took = time.perf_counter() - started
        target = np.clip(np.clip(wanted, before - reach, before + reach), hand.lower, hand.upper)
        corrected = not np.array_equal(q, target)
        kinds_corrected[kind] += corrected
        if np.isfinite(wanted).all():
            times[corrected].append(1e6 * took)
        broken["finite"] += not np.isfinite(q).all()
        broken["limits"] += not ((hand.lower <= q) & (q <= hand.upper)).all()
        broken["speed"] += bool((np.abs(q - before) > reach + 1e-12).any())
        broken["clearance"] += bool(judge.near(q).pairs)
    return {
        "steps": count,
        "commands": dict(kinds),
        "corrected": dict(kinds_corrected),
        "broken": dict(broken),
        "violations": sum(broken.values()),
        "us_passed_on": float(np.median(times[False])),
        "us_corrected": float(np.median(times[True])),
    }
