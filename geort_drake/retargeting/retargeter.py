"""Loads trained maps from human hands to robot joints.

retarget = load_retargeter("allegro_right")
q = retarget(p_HK)
"""

import os
from pathlib import Path

import numpy as np

from geort_drake.errors import CheckpointError, UnknownNameError
from geort_drake.retargeting.checkpoint import TrainedHand, load_checkpoint
from geort_drake.retargeting.map_file import load_map, shipped_maps
from geort_drake.retargeting.methods import trained_method
from geort_drake.retargeting.numpy_retargeter import Retargeter
from geort_drake.retargeting.universal import UniversalRetargeter

BACKENDS = ("numpy", "numba")

__all__ = ["BACKENDS", "Retargeter", "UniversalRetargeter", "load_retargeter", "path_of", "shipped_map"]


def shipped_map(hand: TrainedHand) -> Path:
    """Returns the file of the universal map that is shipped for `hand`.

    Raises:
        CheckpointError: there is none.
    """
    for path in dict.fromkeys(shipped_maps().values()):
        if hand.digest in load_map(path).hands.values():
            return path
    hands = ", ".join(shipped_maps()) or "none"
    raise CheckpointError(
        f"no universal map is shipped for this hand, only for: {hands}; geort-drake pretrain makes one"
    )


def path_of(source: str | os.PathLike) -> Path:
    """Returns the map file or checkpoint directory that `load_retargeter` loads for `source`."""
    return shipped_maps().get(os.fspath(source), Path(source))


def load_retargeter(
    source: str | os.PathLike, hand: TrainedHand | None = None, backend: str = "numpy"
) -> Retargeter | UniversalRetargeter:
    """Loads a universal map, or a checkpoint directory written by training.

    Args:
        source: name of a robot hand with a shipped map, or path of a map file or checkpoint directory.
        hand: a hand model (`joint_names`, `finger_names`, `digest`) for which the map must have been trained;
            None skips the check.
        backend: "numpy", or "numba", which halves the time of calls for one hand; see `Retargeter.compile`.

    Raises:
        CheckpointError: a file is missing or altered, or the map is for another hand.
        UnknownNameError: the checkpoint's method or the backend is unknown.
        GeortError: the backend is numba, which is not installed.
    """
    if backend not in BACKENDS:
        raise UnknownNameError("backend", backend, BACKENDS)
    path = path_of(source)
    if path.is_file():
        return _universal(path, hand, backend)
    if not path.exists():
        shipped = ", ".join(shipped_maps()) or "none"
        raise CheckpointError(
            f"{path}: neither a checkpoint directory, which geort-drake train writes, nor a map file; "
            f"maps shipped with this version: {shipped}"
        )
    checkpoint = load_checkpoint(path)
    if hand is not None:
        checkpoint.check_hand(hand)
    retargeter = trained_method(checkpoint.config["method"]).retargeter(
        checkpoint.arrays,
        checkpoint.config["finger_names"],
        checkpoint.config["joint_names"],
        checkpoint.config["human_keypoints"],
        np.array(checkpoint.hand["lower"]),
        np.array(checkpoint.hand["upper"]),
    )
    retargeter.trained_space = checkpoint.trained_space
    retargeter.robot_hands = (checkpoint.hand["name"],)
    if backend == "numba":
        retargeter.compile()
    return retargeter


def _universal(path: Path, hand: TrainedHand | None, backend: str) -> UniversalRetargeter:
    file = load_map(path)
    if hand is not None:
        file.check_hand(path, hand)
    retargeter = UniversalRetargeter(
        file.arrays,
        file.finger_names,
        file.joint_names,
        file.human_keypoints,
        np.array(file.lower),
        np.array(file.upper),
        backend,
    )
    retargeter.robot_hands = tuple(file.hands)
    return retargeter
