"""Finds retargeters by the name of a method, or the path of a map or a Python file."""

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geort_drake.errors import BenchmarkError, MethodError, UnknownNameError
from geort_drake.hands.hand import Hand
from geort_drake.own_method import OwnMethod
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.play import synthesize_play
from geort_drake.retargeting import DEFAULT_METHOD, METHODS, train
from geort_drake.retargeting.base import Retarget
from geort_drake.retargeting.store import SUFFIX, fit, load_retargeter, shipped_maps
from geort_drake.retargeting.universal import UniversalRetargeter

# Number of parts of the recording, successive frames per part, and untimed frames at the start of a part.
_PARTS, _SUCCESSIVE, _WARM_UP = 10, 40, 10


def is_own(method: str) -> bool:
    """Returns whether this is the path of a Python file with a user's own method."""
    return Path(method).suffix == ".py"


def is_trained(method: str) -> bool:
    """Returns whether this is the name of a method that is trained on the recording."""
    return method in METHODS and METHODS[method].is_trained


def names_of(methods: Sequence[str], hand: Hand) -> dict[str, str]:
    """Returns name → method without duplicates, after checks; maps and Python files are named by their paths.

    Raises:
        UnknownNameError: an entry is neither a method nor a map or a Python file.
        MethodError: a Python file is missing.
        BenchmarkError: two different entries have the same name.
        MapError: a map is damaged or for another hand, or no map is shipped for `hand`.
    """
    names: dict[str, str] = {}
    for method in methods:
        path, is_method = Path(method).resolve(), method in METHODS
        is_python = is_own(method)
        if is_python and not path.is_file():
            raise MethodError(f"{method}: no such file; it must define make(hand)")
        if not (is_python or is_method or path.suffix == SUFFIX):
            raise UnknownNameError("retargeting method or map", method, METHODS)
        if method == "universal":
            fit(hand)
        elif not (is_method or is_python):
            load_retargeter(path, hand)
        name, source = (method, method) if is_method else (path.name, str(path))
        if names.setdefault(name, source) != source:
            raise BenchmarkError(
                f"two methods have the name '{name}': {names[name]} and {source}; rename one"
            )
    return names


def methods_for(hand: Hand) -> list[str]:
    """Returns all methods; the universal map only if one is shipped for the hand."""
    return [name for name in METHODS if name != "universal" or hand.description.name in shipped_maps()]


def default_method(hand: Hand) -> str:
    """Returns the method to take where none is named: the hand's universal map, or one that is trained."""
    return "universal" if hand.description.name in shipped_maps() else DEFAULT_METHOD


def resolve(
    method: str, hand: Hand, recording: Recording | None = None, seed: int = 0, device: str = "cpu"
) -> tuple[Retarget, Path | None]:
    """Returns a retargeter, and the path of its map or Python file; None for an untrained method.

    Args:
        method: name of a method, or path of a map or a Python file.
        recording: training data, or the frames that an untrained method uses and on the first of which an own
            method is examined; None synthesises as much play as the method needs, at most five minutes.
        seed: seed of the training, or of an untrained method's random samples.
        device: "cpu" or "cuda", for the training.

    Raises:
        MethodError: a Python file has no usable method, see `OwnMethod.check`.
        MapError: a map is damaged or for another hand, or no map is shipped for `hand`.
        RecordingError, TrainingError: see `train.cached_map`.
    """
    path = Path(method)
    if is_own(method):
        own = OwnMethod(path.resolve(), hand)
        play = synthesize_play(seed=0, duration_s=1.0) if recording is None else recording
        own.check(play.p_HK[play.valid][0].astype(float))
        own.reset()
        return own, path
    if method not in METHODS:
        return load_retargeter(path, hand), path
    if method == "universal":
        return fit(hand), shipped_maps()[hand.description.name]
    recording = train.training_recording(recording, hand.description.side, seed)
    if is_trained(method):
        return train.cached_map(hand, recording, method, seed, device)
    p_HF = recording.fingertips(hand.description.human_keypoints)
    return METHODS[method].fit(hand, p_HF, seed=seed), None


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
            start = clock()
            retarget(frame)
            # Online methods take longer after the jump to another part.
            if number >= _WARM_UP:
                times.append(clock() - start)
    return float(np.median(times))
