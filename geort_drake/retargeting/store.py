"""Files of trained maps, and `load_retargeter`.

A map is one safetensors file. Its header has an entry "geort_drake" with a JSON object:

    format           2
    kind             of the weights: "mlp" or "universal"
    robot_hands      names of the robot hands for which the map was made
    finger_names, joint_names, human_keypoints, lower, upper   as in `Retargeter`
    info             method, config, provenance; of a universal map figures, of others metrics and history
"""

import json
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import safe_open

from geort_drake.errors import MapError
from geort_drake.people.keypoints import KEYPOINT_COUNT
from geort_drake.resources import models_dir
from geort_drake.retargeting.base import FORMAT, HEADER, TRAINED_POINTS, Retargeter, require_arrays
from geort_drake.retargeting.mlp import MlpRetargeter
from geort_drake.retargeting.universal import UniversalRetargeter

SUFFIX = ".safetensors"
_KINDS = {kind.kind: kind for kind in (MlpRetargeter, UniversalRetargeter)}
_NAMES = ("finger_names", "joint_names", "robot_hands")


def load_retargeter(source: str | os.PathLike, hand: Any = None) -> Retargeter:
    """Loads a trained map; needs only NumPy and safetensors.

    Args:
        source: name of a robot hand with a shipped map, or path of a map's file.
        hand: a hand model for which the map must have been made; None skips the check. Another version of
            the model causes a RuntimeWarning.

    Raises:
        MapError: the file is missing or damaged, or the map is for another hand.
    """
    path = shipped_maps().get(os.fspath(source), Path(source))
    if not path.is_file():
        raise MapError(
            f"{path}: no such map, which geort-drake train writes; maps shipped with this version are for "
            f"{', '.join(shipped_maps()) or 'no hand'}"
        )
    header = _read_header(path)
    try:
        with safe_open(path, "numpy") as file:
            arrays = {name: file.get_tensor(name) for name in file.keys()}
        points = {name: arrays.pop(name) for name in [TRAINED_POINTS] if name in arrays}
        names = header["finger_names"], header["joint_names"]
        limits = np.array(header["lower"]), np.array(header["upper"])
        retargeter = _KINDS[header["kind"]](*names, header["human_keypoints"], *limits, arrays)
        if points:
            axes, sizes = {TRAINED_POINTS: "F points 3"}, {"F": len(header["finger_names"])}
            retargeter.trained_points = require_arrays(points, axes, sizes)[TRAINED_POINTS]
    except MapError as error:
        raise MapError(f"{path}: {error}") from error
    retargeter.robot_hands, retargeter.info = tuple(header["robot_hands"]), header["info"]
    if hand is not None:
        _check_hand(path, retargeter, hand)
    return retargeter


def fit(hand: Any, p_HF: np.ndarray | None = None, **_options: Any) -> Retargeter:
    """Loads the universal map that is shipped for a hand; see `Method.fit`.

    Raises:
        MapError: there is none.
    """
    name = hand.description.name
    if name not in shipped_maps():
        raise MapError(
            f"no universal map is shipped for {name}, only for {', '.join(shipped_maps()) or 'no hand'}; "
            "geort-drake train makes one"
        )
    return load_retargeter(name, hand)


def shipped_maps() -> dict[str, Path]:
    """Returns the maps shipped with the package: name of the robot hand → its file, which has this name."""
    return {path.stem: path for path in sorted((models_dir() / "maps").glob(f"*{SUFFIX}"))}


def _read_header(path: Path) -> dict[str, Any]:
    """Reads and checks the JSON object in the header of a map's file."""

    def require(holds: Any, message: str) -> None:
        if not holds:
            raise MapError(f"{path}: {message}")

    try:
        with safe_open(path, "numpy") as file:
            text = (file.metadata() or {}).get(HEADER, "")
    except Exception as error:  # safetensors raises exceptions of its own and built-in ones
        raise MapError(f"{path}: not a safetensors file: {error}") from error
    require(bool(text), "not a map of geort-drake: its header has no 'geort_drake'")
    try:
        header = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise MapError(f"{path}: the header is not valid JSON: {error}") from error
    require(isinstance(header, dict), "the header must contain a JSON object")
    require(header.get("format") == FORMAT, f"format is {header.get('format')}, this version reads {FORMAT}")
    require(header.get("kind") in _KINDS, f"kind must be one of {', '.join(_KINDS)}: {header.get('kind')}")
    for field in _NAMES:
        names = header.get(field)
        is_list = isinstance(names, list) and all(isinstance(name, str) for name in names)
        require(
            is_list and bool(names or field == "robot_hands"), f"{field} must be names, not {names!r:.60}"
        )
    joints, fingers = len(header["joint_names"]), len(header["finger_names"])
    for field, count in (("lower", joints), ("upper", joints), ("human_keypoints", fingers)):
        numbers = header.get(field)
        is_list = isinstance(numbers, list) and all(type(each) in (int, float) for each in numbers)
        require(
            is_list and len(numbers) == count and bool(np.isfinite(np.array(numbers, float)).all()),
            f"{field} must be {count} finite numbers, not {numbers!r:.60}",
        )
    for joint, low, high in zip(header["joint_names"], header["lower"], header["upper"], strict=True):
        require(low < high < low + 1e3, f"lower of '{joint}' must be below upper, {high:g}; it is {low:g}")
    are_keypoints = all(type(k) is int and 0 <= k < KEYPOINT_COUNT for k in header["human_keypoints"])
    require(are_keypoints, f"human_keypoints must be numbers from 0 to {KEYPOINT_COUNT - 1}")
    require(isinstance(header.get("info"), dict), "info must be a JSON object")
    return header


def _check_hand(path: Path, retargeter: Retargeter, hand: Any) -> None:
    hands = ", ".join(retargeter.robot_hands)
    if hands and hasattr(hand, "description") and hand.description.name not in retargeter.robot_hands:
        raise MapError(
            f"{path}: the map is for {hands}, not for the robot hand {hand.description.name}; choose that "
            "hand with --hand, or train a map for this one. If it is the same hand, give its description the "
            "name in the map"
        )
    for what in ("finger_names", "joint_names"):
        expected, names = tuple(getattr(hand, what)), getattr(retargeter, what)
        if expected != names:
            raise MapError(
                f"{path}: the map is for another hand ({hands}); its "
                f"{what.replace('_', ' ')} are {', '.join(names)}, expected {', '.join(expected)}; choose "
                "that hand with --hand, or train a map for this one"
            )
    digests = retargeter.info.get("provenance", {}).get("hands", {})
    if digests and hand.digest not in digests.values():
        warnings.warn(
            f"{path}: the map was made for another version of the hand's model", RuntimeWarning, stacklevel=3
        )
