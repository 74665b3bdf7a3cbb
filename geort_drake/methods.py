"""Finds retargeters by the name of a method, or the path of a checkpoint, a map or a Python file."""

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geort_drake.comparison import train
from geort_drake.errors import BenchmarkError, MethodError, UnknownNameError
from geort_drake.hands.hand import Hand, canonical_kinematics
from geort_drake.own_method import OwnMethod
from geort_drake.people.recording import Recording
from geort_drake.retargeting.checkpoint import CONFIG
from geort_drake.retargeting.map_file import SUFFIX
from geort_drake.retargeting.method import Retarget
from geort_drake.retargeting.methods import (
    all_methods,
    make_untrained,
    shipped_methods,
    trained_methods,
    untrained_methods,
)
from geort_drake.retargeting.retargeter import UniversalRetargeter, load_retargeter, shipped_map

PYTHON_SUFFIX = ".py"  # of a user's own method
# Number of parts of the recording, successive frames per part, and untimed frames at the start of a part.
_PARTS, _SUCCESSIVE, _WARM_UP = 10, 40, 10


def names_of(methods: Sequence[str], hand: Hand | None = None) -> dict[str, str]:
    """Returns name → method without duplicates; checkpoints, maps and Python files are named by their paths.

    With a `hand`, checkpoints and maps must be for this hand.

    Raises:
        UnknownNameError: an entry is neither a method nor a checkpoint, a map or a Python file.
        MethodError: a Python file is missing.
        BenchmarkError: two different entries have the same name.
        CheckpointError: a checkpoint or map is damaged or for another hand, or no map is shipped for `hand`.
    """
    names: dict[str, str] = {}
    for method in methods:
        path, is_method = Path(method).resolve(), method in all_methods()
        is_python = path.suffix == PYTHON_SUFFIX
        if is_python and not path.is_file():
            raise MethodError(f"{method}: no such file; it must define make(hand)")
        if not (is_python or is_method or (path / CONFIG).is_file() or path.suffix == SUFFIX):
            raise UnknownNameError("retargeting method or checkpoint", method, all_methods())
        if hand is not None and not (is_method or is_python):
            load_retargeter(path, hand)
        elif hand is not None and method in shipped_methods():
            shipped_map(hand)
        name, source = (method, method) if is_method else (path.name, str(path))
        if names.setdefault(name, source) != source:
            raise BenchmarkError(
                f"two methods have the name '{name}': {names[name]} and {source}; rename one"
            )
    return names


def resolve(
    method: str, hand: Hand, recording: Recording, seed: int = 0, device: str = "cpu"
) -> tuple[Retarget, Path | None]:
    """Returns a retargeter, and the path of its checkpoint, map or Python file; None for an untrained method.

    Args:
        method: name of a method, or path of a checkpoint, a map or a Python file.
        recording: training data, or the frames that an untrained method uses.
        seed: seed of the training, or of an untrained method's random samples.
        device: "cpu" or "cuda", for the training.
    """
    path = Path(method)
    if path.suffix == PYTHON_SUFFIX:
        return OwnMethod(path.resolve(), hand.description), path
    if method in untrained_methods():
        keypoints, kinematics = hand.description.human_keypoints, canonical_kinematics(hand)
        frames = recording.fingertips(keypoints)
        return make_untrained(method, kinematics, keypoints, frames=frames, seed=seed), None
    if method in shipped_methods():
        path = shipped_map(hand)
    elif method in trained_methods():
        path = train.cached_checkpoint(hand.description, recording, method, seed, device)
    return load_retargeter(path, hand), path


def measure_latency(retarget: Retarget, recording: Recording) -> float:
    """Returns the median processor time of a call, s, over frames from all parts of a recording.

    Wall time would include other work of the machine. It is measured only for an `OwnMethod`, which may wait
    for another thread, process or device.
    """
    frames = recording.p_HK[recording.valid].astype(float)
    if isinstance(retarget, UniversalRetargeter):
        retarget = retarget.for_person(frames)  # as `RetargetingSystem` does
    clock = time.perf_counter if isinstance(retarget, OwnMethod) else time.thread_time
    times = []
    for first in np.linspace(0, max(len(frames) - _SUCCESSIVE, 0), _PARTS).astype(int):
        for number, frame in enumerate(frames[first : first + _SUCCESSIVE]):
            started = clock()
            retarget(frame)
            # Online methods take longer after the jump to another part.
            if number >= _WARM_UP:
                times.append(clock() - started)
    return float(np.median(times))
