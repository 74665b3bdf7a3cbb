"""Registry of the retargeting methods.

A module of this package adds methods by defining `METHODS`, a tuple of `TrainedMethod`, `ShippedMethod` or
`UntrainedMethod`. It must import torch and SciPy inside its functions, because loading a retargeter imports
all of these modules and works without torch.
"""

import functools
import importlib
import pkgutil
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from geort_drake.errors import UnknownNameError
from geort_drake.retargeting.method import Retarget, ShippedMethod, TrainedMethod, UntrainedMethod

if TYPE_CHECKING:
    from geort_drake.retargeting.training.kinematics import HandKinematics

DEFAULT_METHOD = "geort_coupled"


@functools.cache
def all_methods() -> dict[str, TrainedMethod | ShippedMethod | UntrainedMethod]:
    """Returns all methods by name, the trained ones first."""
    found: list[TrainedMethod | ShippedMethod | UntrainedMethod] = []
    for module in pkgutil.iter_modules(__path__):
        found += getattr(importlib.import_module(f"{__name__}.{module.name}"), "METHODS", ())
    found.sort(key=lambda method: (not isinstance(method, TrainedMethod), method.name))
    return {method.name: method for method in found}


def trained_methods() -> dict[str, TrainedMethod]:
    """Returns the methods that are trained, by name."""
    return {name: method for name, method in all_methods().items() if isinstance(method, TrainedMethod)}


def shipped_methods() -> dict[str, ShippedMethod]:
    """Returns the methods whose maps are shipped, by name."""
    return {name: method for name, method in all_methods().items() if isinstance(method, ShippedMethod)}


def untrained_methods() -> dict[str, UntrainedMethod]:
    """Returns the methods that need no training, by name."""
    return {name: method for name, method in all_methods().items() if isinstance(method, UntrainedMethod)}


def trained_method(name: str) -> TrainedMethod:
    """Returns the trained method of a name.

    Raises:
        UnknownNameError: there is none; the message lists the known methods.
    """
    methods = trained_methods()
    if name not in methods:
        raise UnknownNameError("retargeting method", name, methods)
    return methods[name]


def make_untrained(
    name: str,
    kinematics: "HandKinematics",
    human_keypoints: Sequence[int] | None = None,
    frames: np.ndarray | None = None,
    seed: int = 0,
) -> Retarget:
    """Makes a retargeter that needs no training; it is called as a `Retargeter`.

    Args:
        name: name of the method, from `untrained_methods()`.
        kinematics: kinematics of the robot hand, mirrored for a left hand.
        human_keypoints: keypoint of each fingertip; by default the fingers' names determine it.
        frames: recorded fingertips (T, F, 3), m, which affine_ik needs.
        seed: seed of its draws.

    Raises:
        UnknownNameError: there is no such method.
        GeortError: frames are missing.
    """
    methods = untrained_methods()
    if name not in methods:
        raise UnknownNameError("retargeting method without training", name, methods)
    return methods[name].make(kinematics, human_keypoints, frames, seed)
