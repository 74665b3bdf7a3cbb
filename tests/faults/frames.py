"""Faulty glove frames and wrist poses, through retargeting and arm."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from arm_bench import PERIOD, ArmBench
from pydrake.math import RigidTransform, RollPitchYaw

from faults.bench import Bench, Watch
from faults.sound import LOWER, TIPS, UPPER, play, smooth_retargeter
from geort_drake.errors import GeortError
from geort_drake.systems.joint_limits import JointLimits

Frame = tuple[np.ndarray, float, float]  # keypoints (21, 3), valid, stamp
Fault = Callable[[np.ndarray, float, float, np.ndarray, np.random.Generator], Frame]


def _spoil(rows, value) -> Fault:
    def fault(p, valid, stamp, last, rng):
        p[rng.integers(0, 21) if rows is None else rows] = value
        return p, valid, stamp

    return fault


def _scaled(factors) -> Fault:
    return lambda p, valid, stamp, last, rng: (p * rng.choice(factors), valid, stamp)


def _stamped(shift: Callable[[float, np.random.Generator], float]) -> Fault:
    return lambda p, valid, stamp, last, rng: (p, valid, shift(stamp, rng))


# Each changes a frame; `last` is the frame before.
FAULTS: dict[str, Fault] = {
    "dropout": lambda p, valid, stamp, last, rng: (p, 0.0, stamp),
    "dropout with rubbish": lambda p, valid, stamp, last, rng: (rng.normal(0, 1e6, (21, 3)), 0.0, stamp),
    "NaN": _spoil(None, np.nan),
    "infinite": _spoil(8, -np.inf),
    "huge": _scaled([1e30, -1e300]),
    "scale": _scaled([-1.0, 0.0, 0.1, 1.3, 10.0, 1000.0]),
    "swap": lambda p, valid, stamp, last, rng: (p[[0, *rng.permutation(20) + 1]], valid, stamp),
    "jump": lambda p, valid, stamp, last, rng: (p + rng.uniform(-0.3, 0.3, 3), valid, stamp),
    "noise": lambda p, valid, stamp, last, rng: (p + rng.normal(0, 0.02, (21, 3)), valid, stamp),
    "freeze": lambda p, valid, stamp, last, rng: (last.copy(), valid, stamp),
    "zero": _spoil(slice(None), 0.0),
    "time backwards": _stamped(lambda stamp, rng: stamp - rng.choice([0.01, 1.0, 1e9])),
    "time stands": _stamped(lambda stamp, rng: math.floor(stamp)),
    "time NaN": _stamped(lambda stamp, rng: math.nan),
    "valid NaN": lambda p, valid, stamp, last, rng: (p, math.nan, stamp),
}


WristFault = Callable[[RigidTransform, float, np.random.Generator], tuple[RigidTransform, float]]


def _moved(X_WH: RigidTransform, p: np.ndarray, rpy: np.ndarray) -> RigidTransform:
    turned = RigidTransform(RollPitchYaw(rpy), p)
    return RigidTransform(X_WH.rotation() @ turned.rotation(), X_WH.translation() + turned.translation())


# Each changes a wrist's pose X_WH and whether it is tracked.
WRIST_FAULTS: dict[str, WristFault] = {
    "dropout": lambda X, valid, rng: (X, 0.0),
    "dropout with rubbish": lambda X, valid, rng: (RigidTransform(rng.uniform(-99, 99, 3)), 0.0),
    "NaN": lambda X, valid, rng: (RigidTransform([math.nan, 0.0, 0.0]), valid),
    "infinite": lambda X, valid, rng: (RigidTransform([0.0, math.inf, 0.0]), valid),
    "jump": lambda X, valid, rng: (_moved(X, rng.uniform(-5, 5, 3), np.zeros(3)), valid),
    "leap to one place": lambda X, valid, rng: (_moved(X, np.array([5.0, -3.0, 2.0]), np.zeros(3)), valid),
    "turn round": lambda X, valid, rng: (_moved(X, np.zeros(3), rng.uniform(-3, 3, 3)), valid),
    "noise": lambda X, valid, rng: (_moved(X, rng.normal(0, 5e-3, 3), rng.normal(0, 0.02, 3)), valid),
    "origin": lambda X, valid, rng: (RigidTransform(), valid),
    "valid NaN": lambda X, valid, rng: (X, math.nan),
}


def _episodes(names: Iterable[str], rng: np.random.Generator) -> Iterator[str]:
    """Yields the name of each frame's fault, or empty; two thirds of the frames have one, in episodes."""
    names = list(names)
    while True:
        fault = str(rng.choice(names)) if rng.random() < 2 / 3 else ""
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
    broken: Counter[str] = Counter()
    held, in_a_row, speed_when_held = 0, 0, 0.0
    for tick in range(count):
        fault = next(episodes)
        phase = tick * PERIOD * np.array([1.0, 1.7, 2.3])
        X_WH, valid = RigidTransform(RollPitchYaw(0.3 * np.sin(phase)), 0.15 * np.sin(1.3 * phase)), 1.0
        if fault:
            X_WH, valid = WRIST_FAULTS[fault](X_WH, valid, rng)
        q, v, state = bench.tick(X_WH, valid)
        broken.update(bench.watch.broken(q, v))
        faults[fault] += 1
        in_a_row = 0 if valid >= 0.5 and not state else in_a_row + 1
        held += in_a_row > 0
        if in_a_row > 35:
            speed_when_held = max(speed_when_held, float(np.abs(v).max()))
    return {**_counted(faults, held, broken), "speed_when_held": speed_when_held}


def faulty_frames(count: int, rng: np.random.Generator) -> Iterator[tuple[Frame, str]]:
    """Yields `count` faulty frames of play and the name of each one's fault, or empty."""
    recording = play()
    start = int(rng.integers(0, len(recording)))
    last, episodes = recording.p_HK[start].astype(float), _episodes(FAULTS, rng)
    for number in range(count):
        fault = next(episodes)
        frame = recording.p_HK[(start + number) % len(recording)].astype(float), 1.0, 100.0 + 0.01 * number
        if fault:
            frame = FAULTS[fault](*frame, last, rng)
        last = frame[0]
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
        period = float(rng.choice([0.002, 0.01, 0.033]))
        limits = JointLimits(LOWER, UPPER, float(rng.choice([5.0, 7.0])), float(rng.choice([200.0, 700.0])))
        options = {"cutoff": float(rng.choice([0.0, 5.0])), "latency": float(rng.choice([0.0, 0.004]))}
        period = max(period, options["latency"])
        bench = Bench(
            smooth_retargeter(float(rng.choice([1.0, 100.0]))), period, bool(rng.random() < 0.5),
            limits=limits, **options,
        )  # fmt: skip
        watch = Watch(limits, period)
        for (keypoints, valid, stamp), fault in faulty_frames(min(1000, count - done), rng):
            q, v, status = bench.tick(keypoints, valid, stamp)
            broken.update(watch.broken(q, v))
            faults[fault] += 1
            held += status.state.startswith("held")
    return _counted(faults, held, broken)


def fuzz_call(count: int, seed: int, backend: str = "numpy") -> dict:
    """Calls a retargeter with `count` faulty frames: within the limits, or refused as not finite."""
    rng = np.random.default_rng(seed)
    retarget = smooth_retargeter()
    if backend == "numba":
        retarget.compile()
    refused = violations = 0
    for (keypoints, _, _), _ in faulty_frames(count, rng):
        points = keypoints if rng.random() < 0.5 else keypoints[list(TIPS)]
        try:
            q = retarget(points)
        except GeortError:
            refused += 1
            # Refused are points that are not finite, or whose squares are not.
            violations += bool(np.abs(points).max() < 1e150)
        else:
            violations += not ((LOWER <= q) & (q <= UPPER)).all()
    return {"frames": count, "refused": refused, "violations": violations}
