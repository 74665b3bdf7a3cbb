"""The robot's side of training: random joint positions with their fingertips and collision labels."""

import hashlib
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geort_drake.files import atomic_path
from geort_drake.hands.model import HandModel
from geort_drake.resources import cache_dir

# Part of the cache key: raise it when the meaning of the stored arrays changes.
FORMAT_VERSION = 1
_CHUNK = 2000


@dataclass(frozen=True)
class RobotData:
    """N joint positions of a robot hand, uniform within the joint limits, with what follows from them.

    Attributes:
        q: (N, n) joint positions, rad, in the hand description's order.
        p_BF: (N, F, 3) fingertip points in the hand base, m.
        collides: (N,) whether any two parts of the hand touch.
        collides_beyond_tips: (N,) the same, not counting tip against tip.
        digest: the `HandModel.digest` of the hand.
    """

    q: np.ndarray
    p_BF: np.ndarray
    collides: np.ndarray
    collides_beyond_tips: np.ndarray
    digest: str


def robot_data(
    hand: HandModel,
    count: int = 100_000,
    seed: int = 0,
    cache: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RobotData:
    """Samples a hand, or returns what was sampled before with the same hand, count and seed.

    Args:
        hand: the hand.
        count: N, how many samples.
        seed: seed of the uniform distribution within the joint limits.
        cache: directory of stored samples; by default `resources.cache_dir()`.
        progress: called with (done, total) while sampling.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, not {count}")
    path = (cache_dir() if cache is None else Path(cache)) / f"robot-data-{_key(hand, count, seed)}.npz"
    data = _read(path, hand, count)
    if data is None:
        data = _sample(hand, count, seed, progress)
        _write(path, data)
    return data


def _sample(hand, count, seed, progress) -> RobotData:
    q = np.random.default_rng(seed).uniform(hand.lower, hand.upper, size=(count, len(hand.joint_names)))
    p_BF = np.empty((count, len(hand.finger_names), 3))
    collides = np.empty(count, dtype=bool)
    for start in range(0, count, _CHUNK):
        chunk = slice(start, min(start + _CHUNK, count))
        p_BF[chunk] = hand.fingertips(q[chunk])
        collides[chunk] = hand.collides(q[chunk])
        if progress is not None:
            progress(chunk.stop, count)
    # Only a hand that collides at all can collide beyond its tips.
    beyond = np.zeros(count, dtype=bool)
    beyond[collides] = hand.collides_beyond_tips(q[collides])
    return RobotData(q, p_BF, collides, beyond, hand.digest)


def _key(hand: HandModel, count: int, seed: int) -> str:
    text = f"{FORMAT_VERSION} {hand.digest} {count} {seed}"
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _read(path: Path, hand: HandModel, count: int) -> RobotData | None:
    """What is stored at `path`, or None if nothing usable is."""
    n, fingers = len(hand.joint_names), len(hand.finger_names)
    wanted = {
        "q": ((count, n), "f"),
        "p_BF": ((count, fingers, 3), "f"),
        "collides": ((count,), "b"),
        "collides_beyond_tips": ((count,), "b"),
    }
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in wanted}
            whole = str(file["digest"]) == hand.digest
    except FileNotFoundError:
        return None
    except Exception:  # a corrupt archive raises nearly anything
        whole, arrays = False, {}
    whole = whole and all(
        (arrays[name].shape, arrays[name].dtype.kind) == shape_and_kind and np.isfinite(arrays[name]).all()
        for name, shape_and_kind in wanted.items()
    )
    if not whole:
        logging.getLogger(__name__).warning("the cached samples %s are damaged and are made anew", path)
        return None
    return RobotData(**arrays, digest=hand.digest)


def _write(path: Path, data: RobotData) -> None:
    try:
        with atomic_path(path) as draft:
            np.savez(draft, **vars(data))
    except OSError as error:
        # A read-only or full home costs time, not the result.
        logging.getLogger(__name__).warning("the samples cannot be cached at %s: %s", path, error)
