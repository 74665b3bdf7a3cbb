"""Faulty frames, wrist poses and commands through systems."""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator

import numpy as np
from loop_bench import PERIOD, ArmBench
from pydrake.math import RigidTransform, RollPitchYaw
from system_bench import Bench, Watch

from faults.sound import LOWER, UPPER, play, smooth_retargeter
from geort_drake import Hand
from geort_drake.hands.collision import HandClearance
from geort_drake.systems.corrections import SelfCollisionGuard
from geort_drake.systems.joint_limits import JointLimits

KEYPOINT = np.arange(21)[:, None]
# From a frame's keypoints and time, the keypoints before and a generator to what is changed of the frame.
FAULTS: dict[str, Callable[[np.ndarray, float, np.ndarray, np.random.Generator], dict]] = {
    "dropout": lambda p, stamp, last, rng: {"valid": 0.0},
    "dropout with rubbish": lambda p, stamp, last, rng: {
        "keypoints": rng.normal(0, 1e6, (21, 3)),
        "valid": 0.0,
    },
    "NaN": lambda p, stamp, last, rng: {"keypoints": np.where(KEYPOINT == rng.integers(21), np.nan, p)},
    "infinite": lambda p, stamp, last, rng: {"keypoints": np.where(KEYPOINT == 8, -np.inf, p)},
    "huge": lambda p, stamp, last, rng: {"keypoints": p * rng.choice([1e30, -1e300])},
    "scale": lambda p, stamp, last, rng: {"keypoints": p * rng.choice([-1.0, 0.0, 0.1, 1.3, 10.0, 1e3])},
    "swap": lambda p, stamp, last, rng: {"keypoints": p[[0, *rng.permutation(20) + 1]]},
    "jump": lambda p, stamp, last, rng: {"keypoints": p + rng.uniform(-0.3, 0.3, 3)},
    "noise": lambda p, stamp, last, rng: {"keypoints": p + rng.normal(0, 0.02, (21, 3))},
    "freeze": lambda p, stamp, last, rng: {"keypoints": last},
    "time backwards": lambda p, stamp, last, rng: {"stamp": stamp - rng.choice([0.01, 1.0, 1e9])},
    "time stands": lambda p, stamp, last, rng: {"stamp": math.floor(stamp)},
    "time NaN": lambda p, stamp, last, rng: {"stamp": math.nan},
    "valid NaN": lambda p, stamp, last, rng: {"valid": math.nan},
}


def _moved(X_WH: RigidTransform, p=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0)) -> RigidTransform:
    turned = RollPitchYaw(rpy).ToRotationMatrix()
    return RigidTransform(X_WH.rotation() @ turned, X_WH.translation() + p)


# From a wrist's pose X_WH and a generator to another pose, and whether it is tracked.
WRIST_FAULTS: dict[str, Callable[[RigidTransform, np.random.Generator], tuple[RigidTransform, float]]] = {
    "dropout": lambda X, rng: (X, 0.0),
    "dropout with rubbish": lambda X, rng: (RigidTransform(rng.uniform(-99, 99, 3)), 0.0),
    "NaN": lambda X, rng: (RigidTransform([math.nan, 0.0, 0.0]), 1.0),
    "infinite": lambda X, rng: (RigidTransform([0.0, math.inf, 0.0]), 1.0),
    "jump": lambda X, rng: (_moved(X, rng.uniform(-5, 5, 3)), 1.0),
    "leap to one place": lambda X, rng: (_moved(X, [5.0, -3.0, 2.0]), 1.0),
    "turn round": lambda X, rng: (_moved(X, rpy=rng.uniform(-3, 3, 3)), 1.0),
    "noise": lambda X, rng: (_moved(X, rng.normal(0, 5e-3, 3), rng.normal(0, 0.02, 3)), 1.0),
    "origin": lambda X, rng: (RigidTransform(), 1.0),
    "valid NaN": lambda X, rng: (X, math.nan),
}


def _episodes(faults: dict, rng: np.random.Generator) -> Iterator[str]:
    """Yields the name of each frame's fault, or empty; two thirds of the frames have one, in episodes."""
    while True:
        fault = str(rng.choice(list(faults))) if rng.random() < 2 / 3 else ""
        for _ in range(int(rng.choice([1, 2, 5, 30, 120]))):
            yield fault


def _counted(faults: Counter[str], held: int, broken: Counter[str]) -> dict:
    """Returns the figures of a run; frames without a fault are counted under the empty name."""
    return {
        "frames": faults.total(),
        "sound": faults[""],
        "faults": {name: faults[name] for name in sorted(faults) if name},
        "held": held,
        "violations": broken.total(),
        "broken": dict(broken),
    }


def fuzz_arm(count: int, seed: int) -> dict:
    """Drives the arm with `count` faulty wrist poses.

    Returns:
        frames, how many had which fault, how many were held, how often which limit was broken, and the arm's
        largest speed, rad/s, from 0.35 s after the beginning of a hold.
    """
    rng = np.random.default_rng(seed)
    bench, episodes = ArmBench(), _episodes(WRIST_FAULTS, rng)
    faults: Counter[str] = Counter()
    held, in_a_row, speed_when_held = 0, 0, 0.0
    for tick in range(count):
        fault = next(episodes)
        phase = tick * PERIOD * np.array([1.0, 1.7, 2.3])
        X_WH, valid = RigidTransform(RollPitchYaw(0.3 * np.sin(phase)), 0.15 * np.sin(1.3 * phase)), 1.0
        if fault:
            X_WH, valid = WRIST_FAULTS[fault](X_WH, rng)
        _, v, state = bench.tick(X_WH, valid)
        faults[fault] += 1
        in_a_row = 0 if valid >= 0.5 and not state else in_a_row + 1
        held += in_a_row > 0
        if in_a_row > 35:
            speed_when_held = max(speed_when_held, float(np.abs(v).max()))
    return {**_counted(faults, held, bench.broken), "speed_when_held": speed_when_held}


def faulty_frames(count: int, rng: np.random.Generator) -> Iterator[tuple[dict, str]]:
    """Yields `count` frames of play (keypoints, valid, stamp) and each one's fault, or empty."""
    recording = play()
    start = int(rng.integers(0, len(recording)))
    last, episodes = recording.p_HK[start].astype(float), _episodes(FAULTS, rng)
    for number in range(count):
        fault = next(episodes)
        p, stamp = recording.p_HK[(start + number) % len(recording)].astype(float), 100.0 + 0.01 * number
        frame = {"keypoints": p, "valid": 1.0, "stamp": stamp}
        if fault:
            frame |= FAULTS[fault](p, stamp, last, rng)
        last = frame["keypoints"]
        yield frame, fault


def fuzz_system(count: int, seed: int) -> dict:
    """Drives systems of several periods, gains, low-passes and latencies through `count` faulty frames.

    Returns:
        frames, how many had which fault, how many were held, and how often which guarantee was broken.
    """
    rng = np.random.default_rng(seed)
    faults: Counter[str] = Counter()
    broken: Counter[str] = Counter()
    held = 0
    for done in range(0, count, 1000):
        limits = JointLimits(LOWER, UPPER, float(rng.choice([5.0, 7.0])), float(rng.choice([200.0, 700.0])))
        options = {"cutoff": float(rng.choice([0.0, 5.0])), "latency": float(rng.choice([0.0, 0.004]))}
        period = max(float(rng.choice([0.002, 0.01, 0.033])), options["latency"])
        retarget = smooth_retargeter(float(rng.choice([1.0, 100.0])))
        bench = Bench(retarget, period, bool(rng.random() < 0.5), limits=limits, **options)
        watch = Watch(limits, period)
        for frame, fault in faulty_frames(min(1000, count - done), rng):
            q, v, status = bench.tick(**frame)
            broken.update(watch.broken(q, v))
            faults[fault] += 1
            held += status.state.startswith("held")
    return _counted(faults, held, broken)


CLEARANCE = 0.002  # m
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
    hand = Hand("allegro_right")
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
