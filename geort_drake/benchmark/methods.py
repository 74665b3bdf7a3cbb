"""Retargeting methods of a grasp benchmark: training, loading and timing."""

import shutil
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geort_drake.benchmark.own_method import PYTHON, OwnMethod
from geort_drake.benchmark.records import training_of
from geort_drake.comparison.comparison import check_methods, method_names
from geort_drake.comparison.train import cached_checkpoint
from geort_drake.errors import BenchmarkError, MethodError
from geort_drake.files import atomic_directory, atomic_path, sha256_of
from geort_drake.hands.mirror import canonical_kinematics
from geort_drake.hands.model import HandModel
from geort_drake.people.recording import Recording
from geort_drake.retargeting.checkpoint import WEIGHTS
from geort_drake.retargeting.map_file import SUFFIX
from geort_drake.retargeting.methods import (
    make_untrained,
    shipped_methods,
    trained_methods,
    untrained_methods,
)
from geort_drake.retargeting.retargeter import UniversalRetargeter, load_retargeter, shipped_map
from geort_drake.simulation.diagram import Retarget

# Timed parts of a recording, successive frames in each, and frames at its start that are not timed.
_PARTS, _SUCCESSIVE, _WARM_UP = 10, 40, 10


def names_of(methods: Sequence[str], trainings: int = 1) -> dict[str, str]:
    """Name → method, without repeats; a checkpoint, map or Python file is named after its directory or file.

    A method that is trained several times has a name for each training: geort, geort~1, geort~2.

    Raises:
        UnknownNameError: neither a method nor a checkpoint.
        MethodError: there is no such Python file.
        BenchmarkError: two different ones have the same name.
    """
    files = [given for given in methods if Path(given).suffix == PYTHON]
    check_methods([given for given in methods if given not in files])
    for given in files:
        if not Path(given).is_file():
            raise MethodError(f"{given}: no such file; it must define make(hand)")
    names: dict[str, str] = {}
    for given in methods:
        path = Path(given).resolve()
        name, method = (given, given) if given in method_names() else (path.name, str(path))
        if names.setdefault(name, method) != method:
            raise BenchmarkError(
                f"two methods have the name '{name}': {names[name]} and {method}; rename one directory"
            )
        if method in trained_methods():
            names |= {f"{name}~{number}": method for number in range(1, trainings)}
    return names


def make_retargeter(
    name: str, method: str, keep: Path, hand_name: str, hand: HandModel, recording: Recording, seed: int
) -> tuple[Retarget, str | None]:
    """A retargeter, and the digest of its weights; None if nothing is learned.

    Args:
        name, method: an item of `names_of`.
        keep: folder for a copy of the checkpoint, map or Python file.
        hand_name: name or file of the robot hand's description.
        hand: its model.
        recording: training data, or the frames that an untrained method uses.
        seed: of the first training, and of an untrained method's draws.

    Raises:
        UnknownNameError, CheckpointError, TrainingError: see `cached_checkpoint` and `load_retargeter`.
        MethodError: see `OwnMethod.check`.
    """
    if method in untrained_methods():
        keypoints = hand.description.human_keypoints
        frames = recording.fingertips(keypoints).astype(float)
        return make_untrained(method, canonical_kinematics(hand), keypoints, frames=frames, seed=seed), None
    if Path(method).suffix == PYTHON:
        kept = keep / name
        OwnMethod(Path(method), hand_name).check(recording.p_HK[recording.valid][0])
        if not kept.is_file():
            with atomic_path(kept) as draft:
                shutil.copyfile(method, draft)
        return OwnMethod(kept, hand_name), sha256_of(method)
    if method in shipped_methods() or Path(method).suffix == SUFFIX:
        kept = (keep / name).with_suffix(SUFFIX)
        if not kept.is_file():
            with atomic_path(kept) as draft:
                shutil.copyfile(shipped_map(hand) if name == method else method, draft)
        return load_retargeter(kept, hand), sha256_of(kept)
    kept = keep / name
    if method not in trained_methods():
        load_retargeter(method, hand)
        source = Path(method)
    elif kept.is_dir():
        source = kept
    else:
        source, _ = cached_checkpoint(hand_name, recording, method, seed + training_of(name)[1])
    if not kept.is_dir():
        with atomic_directory(kept) as draft:
            shutil.copytree(source, draft, dirs_exist_ok=True)
    return load_retargeter(source, hand), sha256_of(source / WEIGHTS)


def measure_latency(retarget: Retarget, recording: Recording) -> float:
    """Median processor time of a call over frames from all parts of a recording, s.

    Wall time would include other work of the machine. It counts for one's own method, which may wait for
    another thread, process or device.
    """
    frames = recording.p_HK[recording.valid].astype(float)
    if isinstance(retarget, UniversalRetargeter):
        retarget = retarget.for_person(frames)  # as `RetargetingSystem` does, now and then
    clock = time.perf_counter if isinstance(retarget, OwnMethod) else time.thread_time
    times = []
    for first in np.linspace(0, max(len(frames) - _SUCCESSIVE, 0), _PARTS).astype(int):
        for number, frame in enumerate(frames[first : first + _SUCCESSIVE]):
            started = clock()
            retarget(frame)
            # Online methods take longer for a hand that has jumped.
            if number >= _WARM_UP:
                times.append(clock() - started)
    return float(np.median(times))
