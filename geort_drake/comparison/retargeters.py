"""Finds retargeters by the name of a method or the path of a checkpoint or map."""

from collections.abc import Sequence
from pathlib import Path

from geort_drake.comparison import train
from geort_drake.errors import BenchmarkError, MethodError, UnknownNameError
from geort_drake.hands.hand import canonical_kinematics
from geort_drake.hands.model import HandModel
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
from geort_drake.retargeting.retargeter import load_retargeter, shipped_map

PYTHON_SUFFIX = ".py"  # of a user's own method in the grasp benchmark


def names_of(methods: Sequence[str], trainings: int = 1, hand: HandModel | None = None) -> dict[str, str]:
    """Returns name → method without duplicates; checkpoints, maps and Python files are named by their paths.

    A method that is trained several times has a name for each training: geort, geort~1, geort~2. Python files
    are methods only without `hand`, whose checkpoints and maps are checked.

    Raises:
        UnknownNameError: an entry is neither a method nor a checkpoint, a map or a Python file.
        MethodError: a Python file is missing, or given with `hand`.
        BenchmarkError: two different entries have the same name.
        CheckpointError: a checkpoint or map is damaged or for another hand, or no map is shipped for `hand`.
    """
    names: dict[str, str] = {}
    for given in methods:
        path, is_method = Path(given).resolve(), given in all_methods()
        is_python = path.suffix == PYTHON_SUFFIX
        if is_python and hand is not None:
            raise MethodError(f"{given}: a Python file is a method of geort-drake benchmark only")
        if is_python and not path.is_file():
            raise MethodError(f"{given}: no such file; it must define make(hand)")
        if not (is_python or is_method or (path / CONFIG).is_file() or path.suffix == SUFFIX):
            raise UnknownNameError("retargeting method or checkpoint", given, all_methods())
        if hand is not None and not is_method:
            load_retargeter(path, hand)
        elif hand is not None and given in shipped_methods():
            shipped_map(hand)
        name, method = (given, given) if is_method else (path.name, str(path))
        if names.setdefault(name, method) != method:
            raise BenchmarkError(
                f"two methods have the name '{name}': {names[name]} and {method}; rename one"
            )
        if method in trained_methods():
            names |= {f"{name}~{number}": method for number in range(1, trainings)}
    return names


def retargeter_of(
    method: str, hand: HandModel, recording: Recording, seed: int, device: str = "cpu"
) -> tuple[Retarget, Path | None]:
    """Returns a retargeter and the path of its checkpoint or map, None for an untrained method.

    Args:
        method: name of a method, or path of a checkpoint or map.
        recording: training data, or the frames that an untrained method uses.
        seed: seed of the training, or of an untrained method's random samples.
        device: "cpu" or "cuda", for the training.
    """
    if method in untrained_methods():
        keypoints, kinematics = hand.description.human_keypoints, canonical_kinematics(hand)
        frames = recording.fingertips(keypoints)
        return make_untrained(method, kinematics, keypoints, frames=frames, seed=seed), None
    path = Path(method)
    if method in shipped_methods():
        path = shipped_map(hand)
    elif method in trained_methods():
        path = train.cached_checkpoint(hand.description, recording, method, seed, device)
    return load_retargeter(path, hand), path
