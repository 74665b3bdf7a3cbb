"""Trains, loads and times the retargeting methods of a benchmark."""

import shutil
import time
from pathlib import Path

import numpy as np

from geort_drake.benchmark.own_method import OwnMethod
from geort_drake.benchmark.records import training_of
from geort_drake.comparison.retargeters import PYTHON_SUFFIX, retargeter_of
from geort_drake.files import atomic_directory, atomic_path, sha256_of
from geort_drake.hands.model import HandModel
from geort_drake.people.recording import Recording
from geort_drake.retargeting.checkpoint import WEIGHTS
from geort_drake.retargeting.map_file import SUFFIX
from geort_drake.retargeting.method import Retarget
from geort_drake.retargeting.methods import all_methods, shipped_methods
from geort_drake.retargeting.retargeter import UniversalRetargeter

# Number of parts of the recording, successive frames per part, and untimed frames at the start of a part.
_PARTS, _SUCCESSIVE, _WARM_UP = 10, 40, 10


def make_retargeter(
    name: str,
    method: str,
    keep: Path,
    hand_name: str,
    hand: HandModel,
    recording: Recording,
    seed: int,
    begun: bool = False,
) -> tuple[Retarget, str | None]:
    """Returns a retargeter, and the digest of its weights or None if it has learned nothing.

    A method with a name is loaded from its copy, if there is one. A path is always loaded itself.

    Args:
        name, method: an item of `names_of`.
        keep: folder for a copy of the checkpoint, map or Python file.
        hand_name: name or file of the robot hand's description.
        hand: model of the robot hand.
        recording: training data, or frames for an untrained method.
        seed: seed of the first training, or of an untrained method's random samples.
        begun: whether the benchmark has trials of the method, so that its copy must stay.

    Raises:
        UnknownNameError, CheckpointError, TrainingError: see `retargeter_of`.
        MethodError: see `OwnMethod.check`.
    """
    given, named = Path(method), method in all_methods()
    # In a folder of its own, because a user's file may have the same name.
    kept = keep / "shipped" / f"{name}{SUFFIX}" if method in shipped_methods() else keep / name
    retarget: Retarget
    path: Path | None
    if given.suffix == PYTHON_SUFFIX:
        OwnMethod(given, hand_name).check(recording.p_HK[recording.valid][0])
        retarget, path = OwnMethod(kept, hand_name), given
    else:
        load = str(kept) if named and kept.exists() else method
        retarget, path = retargeter_of(load, hand, recording, seed + training_of(name)[1])
    if path is None:
        return retarget, None
    if not kept.exists() or not (named or begun):
        with atomic_directory(kept) if path.is_dir() else atomic_path(kept) as draft:
            if path.is_dir():
                shutil.copytree(path, draft, dirs_exist_ok=True)
            else:
                shutil.copyfile(path, draft)
    return retarget, sha256_of(path / WEIGHTS if path.is_dir() else path)


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
