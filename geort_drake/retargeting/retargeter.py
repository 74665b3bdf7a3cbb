"""Loads a trained map from human fingertips to robot joints.

retarget = load_retargeter("runs/allegro_right")
q = retarget(p_HF)
"""

import os

import numpy as np

from geort_drake.errors import UnknownNameError
from geort_drake.retargeting.checkpoint import TrainedHand, load_checkpoint
from geort_drake.retargeting.methods import trained_method
from geort_drake.retargeting.numpy_retargeter import Retargeter

BACKENDS = ("numpy", "numba")

__all__ = ["BACKENDS", "Retargeter", "load_retargeter"]


def load_retargeter(
    path: str | os.PathLike, hand: TrainedHand | None = None, backend: str = "numpy"
) -> Retargeter:
    """Loads a checkpoint directory written by training.

    Args:
        path: the directory.
        hand: a hand model (`joint_names`, `finger_names`, `digest`) for which the checkpoint must have been
            trained; None does not check.
        backend: "numpy", or "numba", which halves the time of calls for one hand; see `Retargeter.compile`.

    Raises:
        CheckpointError: a file is missing or altered, or the checkpoint is for another hand.
        UnknownNameError: this version does not know the checkpoint's method, or there is no such backend.
        GeortError: the backend is numba, which is not installed.
    """
    if backend not in BACKENDS:
        raise UnknownNameError("backend", backend, BACKENDS)
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
    if backend == "numba":
        retargeter.compile()
    return retargeter
