"""Random joint positions of a robot hand for training, with fingertips and collisions as labels."""

import hashlib
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from joblib.externals.loky import ProcessPoolExecutor

from geort_drake.files import atomic_path
from geort_drake.hands.description import HandDescription
from geort_drake.hands.model import HandModel
from geort_drake.processes import end_with, usable_cores
from geort_drake.resources import cache_dir

# Part of the cache key: raise it when the meaning of the stored arrays changes.
FORMAT_VERSION = 1
_CHUNK_SIZE = 500  # samples that one process labels at a time, in 0.02 s
_MIN_SHARED = 40_000  # samples; workers take the time of 20,000 to start


@dataclass(frozen=True)
class RobotData:
    """N joint positions of a robot hand, uniform within the joint limits, with labels.

    Attributes:
        q: (N, n) joint positions, rad, in the hand description's order.
        digest: the `HandModel.digest` of the hand.
        p_BF: (N, F, 3) fingertip points in the hand base, m; None without labels.
        collides_beyond_tips: (N,) whether any two parts of the hand other than two fingertips touch; None
            without labels.
    """

    q: np.ndarray
    digest: str
    p_BF: np.ndarray | None = None
    collides_beyond_tips: np.ndarray | None = None


def robot_data(
    hand: HandModel,
    count: int = 100_000,
    seed: int = 0,
    cache: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
    labels: bool = True,
    processes: int | None = None,
) -> RobotData:
    """Samples a hand; labels are cached by hand, count and seed.

    Args:
        hand: the hand.
        count: N, how many samples.
        seed: seed of the uniform distribution within the joint limits.
        cache: directory of stored samples; by default `resources.cache_dir()`.
        progress: called with (done, total) while labelling.
        labels: whether to compute them; the positions are the same without.
        processes: how many share the labelling, without effect on the result; by default one per core, or
            only this one for few samples.

    Raises:
        ValueError: `count` is less than 1.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, not {count}")
    rng = np.random.default_rng(seed)
    data = RobotData(rng.uniform(hand.lower, hand.upper, size=(count, len(hand.joint_names))), hand.digest)
    if not labels:
        return data
    path = (cache_dir() if cache is None else Path(cache)) / f"robot-data-{_key(hand, count, seed)}.npz"
    labelled = _read(path, data, len(hand.finger_names))
    if labelled is None:
        labelled = _labelled(hand, data, processes, progress)
        _write(path, labelled)
    return labelled


def _labelled(
    hand: HandModel,
    data: RobotData,
    processes: int | None,
    progress: Callable[[int, int], None] | None,
) -> RobotData:
    count = len(data.q)
    if processes is None:
        processes = usable_cores() if count >= _MIN_SHARED else 1
    chunks = np.split(data.q, range(_CHUNK_SIZE, count, _CHUNK_SIZE))
    p_BF = np.empty((count, len(hand.finger_names), 3))
    collides = np.empty(count, dtype=bool)
    done = 0
    for chunk_p_BF, chunk_collides in _labels(hand, chunks, processes):
        rows = slice(done, done + len(chunk_collides))
        p_BF[rows], collides[rows], done = chunk_p_BF, chunk_collides, rows.stop
        if progress is not None:
            progress(done, count)
    return RobotData(data.q, data.digest, p_BF=p_BF, collides_beyond_tips=collides)


def _labels(
    hand: HandModel, chunks: Sequence[np.ndarray], processes: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The labels of each chunk, in order.

    Workers start late, so they begin with the last chunk. This process begins with the first one and labels
    every chunk that no worker has finished.
    """
    if processes < 2:
        yield from (_labels_of(hand, q) for q in chunks)
        return
    pool = ProcessPoolExecutor(processes - 1, initializer=_start, initargs=(os.getpid(), hand.description))
    futures = [pool.submit(_labels_in_worker, q) for q in reversed(chunks)][::-1]
    try:
        for q, future in zip(chunks, futures, strict=True):
            ready = future.done() and future.exception() is None
            yield future.result() if ready else _labels_of(hand, q)
    finally:
        for future in futures:
            future.cancel()
        pool.shutdown(wait=False)


def _labels_of(hand: HandModel, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return hand.fingertips(q), hand.collides_beyond_tips(q)


_worker: dict[str, HandModel] = {}  # the hand of a worker process


def _start(starter: int, description: HandDescription) -> None:
    end_with(starter)
    _worker["hand"] = HandModel(description)


def _labels_in_worker(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return _labels_of(_worker["hand"], q)


def _key(hand: HandModel, count: int, seed: int) -> str:
    text = f"{FORMAT_VERSION} {hand.digest} {count} {seed}"
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _read(path: Path, data: RobotData, fingers: int) -> RobotData | None:
    """`data` with the labels stored at `path`, or None if there are none or they are damaged."""
    count = len(data.q)
    try:
        with np.load(path, allow_pickle=False) as file:
            p_BF, collides = file["p_BF"], file["collides_beyond_tips"]
            intact = str(file["digest"]) == data.digest and np.array_equal(file["q"], data.q)
    except FileNotFoundError:
        return None
    except Exception:  # a corrupt archive raises nearly anything
        intact = False
    if not (
        intact
        and (p_BF.shape, collides.shape, collides.dtype) == ((count, fingers, 3), (count,), bool)
        and np.isfinite(p_BF).all()
    ):
        logging.getLogger(__name__).warning("the cached samples %s are damaged and are computed again", path)
        return None
    return RobotData(data.q, data.digest, p_BF, collides)


def _write(path: Path, data: RobotData) -> None:
    try:
        with atomic_path(path) as draft:
            np.savez(draft, **vars(data))
    except OSError as error:
        # Without a cache, only time is lost.
        logging.getLogger(__name__).warning("the samples cannot be cached at %s: %s", path, error)
