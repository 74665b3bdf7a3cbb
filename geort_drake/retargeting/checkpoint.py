"""Checkpoints: a trained retargeter on disk, with its robot hand and its origin.

weights.safetensors   the arrays of the retargeter, and the fingertip positions seen in training
config.json           format, method, names, keypoints, units, training settings, digests
hand.json             name, joint limits and model digest of the robot hand
provenance.json       recording, seed, versions, timings, training figures
history.csv           losses during training
metrics.json          the evaluation, if there is one
"""

import csv
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from safetensors.numpy import load_file, save

from geort_drake.errors import CheckpointError
from geort_drake.files import atomic_directory, is_replaceable, sha256_of
from geort_drake.people.keypoints import KEYPOINT_COUNT
from geort_drake.retargeting.numpy_kinematics import MAX_ANGLE
from geort_drake.retargeting.trained_space import TrainedSpace

FORMAT = 1
WEIGHTS, CONFIG, HAND = "weights.safetensors", "config.json", "hand.json"
PROVENANCE, HISTORY, METRICS = "provenance.json", "history.csv", "metrics.json"
REQUIRED = (CONFIG, WEIGHTS, HAND, PROVENANCE, HISTORY)
DIGESTED = (WEIGHTS, HAND, HISTORY, PROVENANCE)
TRAINED_POINTS = "trained_points"
MAX_BYTES = 1 << 30  # of one file; trained weights take a megabyte
UNITS = {"human_points": "m, wrist frame H", "joint_angles": "rad"}

_CONFIG_FIELDS = ("format", "method", "finger_names", "joint_names", "human_keypoints", "sha256")
_HAND_FIELDS = ("name", "joint_names", "finger_names", "lower", "upper", "model_sha256")


class TrainedHand(Protocol):
    """The part of a hand model on which a checkpoint depends."""

    @property
    def joint_names(self) -> Sequence[str]: ...
    @property
    def finger_names(self) -> Sequence[str]: ...
    @property
    def digest(self) -> str: ...


@dataclass(frozen=True)
class Checkpoint:
    """The verified contents of a checkpoint directory."""

    path: Path
    config: dict
    hand: dict
    provenance: dict
    arrays: dict[str, np.ndarray]

    @property
    def trained_space(self) -> TrainedSpace | None:
        """Fingertip positions seen in training; None in a checkpoint of version 0.1, which lacks them.

        Raises:
            CheckpointError: the array is malformed.
        """
        if TRAINED_POINTS not in self.arrays:
            return None
        return TrainedSpace(self.arrays[TRAINED_POINTS], self.config["human_keypoints"])

    def check_hand(self, hand: TrainedHand) -> None:
        """Raises CheckpointError unless the checkpoint is for `hand`."""
        comparisons = {
            "joints": (tuple(hand.joint_names), tuple(self.hand["joint_names"])),
            "fingers": (tuple(hand.finger_names), tuple(self.hand["finger_names"])),
            "model digest": (hand.digest, self.hand["model_sha256"]),
        }
        for what, (expected, given) in comparisons.items():
            if expected != given:
                raise CheckpointError(
                    f"{self.path}: the checkpoint is for another hand, '{self.hand['name']}': {what} "
                    f"{_listed(given)}, expected {_listed(expected)}; choose "
                    "that hand with --hand, or train one for this hand"
                )


def save_checkpoint(
    path: str | os.PathLike,
    arrays: Mapping[str, np.ndarray],
    *,
    method: str,
    hand: Mapping,
    human_keypoints: Sequence[int],
    training: Mapping,
    provenance: Mapping,
    history: Sequence[Mapping],
    metrics: Mapping | None = None,
) -> Path:
    """Writes a checkpoint directory atomically; replaces an earlier one.

    Args:
        path: path of the directory.
        arrays: arrays of the retargeter, and under `TRAINED_POINTS` that of a `TrainedSpace`.
        method: name of the retargeting method.
        hand: name, joint_names, finger_names, lower, upper, model_sha256, and other facts.
        human_keypoints: keypoint of each finger, in the order of finger_names.
        training, provenance, metrics: settings, origin and evaluation; JSON types only.
        history: rows with equal keys.

    Raises:
        CheckpointError: `path` contains something other than a checkpoint.
    """
    check_replaceable(path)
    with atomic_directory(path) as draft:
        # save_file would raise no OSError when the disk is full.
        (draft / WEIGHTS).write_bytes(
            save({name: np.ascontiguousarray(array) for name, array in arrays.items()})
        )
        _write_json(draft / HAND, hand)
        _write_json(draft / PROVENANCE, provenance)
        with open(draft / HISTORY, "w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, fieldnames=list(history[0]) if history else ["step"])
            writer.writeheader()
            writer.writerows(history)
        if metrics is not None:
            _write_json(draft / METRICS, metrics)
        config = {
            "format": FORMAT,
            "method": method,
            "finger_names": list(hand["finger_names"]),
            "joint_names": list(hand["joint_names"]),
            "human_keypoints": list(human_keypoints),
            "units": UNITS,
            "training": dict(training),
            "sha256": {name: sha256_of(draft / name) for name in DIGESTED},
        }
        _write_json(draft / CONFIG, config)
    return Path(path)


def check_replaceable(path: str | os.PathLike) -> None:
    """Raises CheckpointError if saving would replace something that is not a checkpoint."""
    if not is_replaceable(path, WEIGHTS):
        raise CheckpointError(
            f"{path} exists and is not a checkpoint; it would be replaced: choose another directory"
        )


def load_checkpoint(path: str | os.PathLike) -> Checkpoint:
    """Reads and verifies a checkpoint directory.

    Raises:
        CheckpointError: the directory or a file is missing, altered, malformed, or of another format.
    """
    path = Path(path)
    if not path.is_dir():
        raise CheckpointError(f"{path}: no such checkpoint directory; geort-drake train writes one")
    missing = [name for name in REQUIRED if not (path / name).is_file()]
    if missing:
        raise CheckpointError(
            f"{path}: {', '.join(missing)} missing; a checkpoint contains {', '.join(REQUIRED)}"
        )
    for name in REQUIRED:
        if (size := (path / name).stat().st_size) > MAX_BYTES:
            raise CheckpointError(
                f"{path / name}: has {size / 2**30:.1f} GiB; files of up to {MAX_BYTES >> 30} GiB are read"
            )
    config = _read_json(path / CONFIG, _CONFIG_FIELDS)
    if config["format"] != FORMAT:
        raise CheckpointError(f"{path / CONFIG}: format is {config['format']}, this version reads {FORMAT}")
    _require(isinstance(config["method"], str), path / CONFIG, "method must be a string", config["method"])
    digests = config["sha256"]
    _require(isinstance(digests, dict), path / CONFIG, "sha256 must be an object", digests)
    if foreign := sorted(set(digests) - set(DIGESTED)):
        raise CheckpointError(
            f"{path / CONFIG}: sha256 names {foreign[0]}, which is not one of {', '.join(DIGESTED)}"
        )
    for name in DIGESTED:
        expected, given = digests.get(name), sha256_of(path / name)
        if expected != given:
            raise CheckpointError(
                f"{path / name}: the file was altered: its sha256 is {given}, {CONFIG} says {expected}"
            )
    hand = _read_json(path / HAND, _HAND_FIELDS)
    for name in ("joint_names", "finger_names"):
        if hand[name] != config[name]:
            raise CheckpointError(
                f"{path}: {name} differ: {HAND} has {_listed(hand[name])}, "
                f"{CONFIG} has {_listed(config[name])}"
            )
    for field in ("name", "model_sha256"):
        _require(isinstance(hand[field], str), path / HAND, f"{field} must be a string", hand[field])
    check_map(path, config | hand)
    try:
        arrays = load_file(path / WEIGHTS)
    except Exception as error:  # safetensors raises exceptions of its own and built-in ones
        raise CheckpointError(f"{path / WEIGHTS}: not a safetensors file: {error}") from error
    return Checkpoint(path, config, hand, _read_json(path / PROVENANCE, ()), arrays)


def _require(holds: bool, path: Path, message: str, value: object) -> None:
    if not holds:
        raise CheckpointError(f"{path}: {message}, not {value!r:.60}")


def check_map(path: Path, fields: Mapping) -> None:
    """Raises CheckpointError unless names, human_keypoints and limits from a map's JSON are valid."""
    for field in ("finger_names", "joint_names"):
        names = fields[field]
        is_list = isinstance(names, list) and names and all(isinstance(name, str) for name in names)
        _require(bool(is_list), path, f"{field} must be a list of names", names)
    keypoints, fingers, joints = fields["human_keypoints"], fields["finger_names"], fields["joint_names"]
    are_keypoints = isinstance(keypoints, list) and all(
        isinstance(number, int) and not isinstance(number, bool) and 0 <= number < KEYPOINT_COUNT
        for number in keypoints
    )
    expected = f"human_keypoints must be a list of numbers from 0 to {KEYPOINT_COUNT - 1}"
    _require(are_keypoints, path, expected, keypoints)
    if len(keypoints) != len(fingers):
        raise CheckpointError(
            f"{path}: {len(fingers)} fingers need as many human_keypoints, there are {len(keypoints)}"
        )
    for field in ("lower", "upper"):
        limits = fields[field]
        is_list = isinstance(limits, list) and len(limits) == len(joints)
        _require(is_list, path, f"{field} must be a list of {len(joints)} numbers", limits)
        for joint, limit in zip(joints, limits, strict=True):
            # Limits are not converted, because an integer may be too large for a float.
            number = isinstance(limit, int | float) and not isinstance(limit, bool)
            expected = f"{field} of '{joint}' must be a number within ±{MAX_ANGLE:g} rad"
            _require(number and abs(limit) <= MAX_ANGLE, path, expected, limit)
    for joint, low, high in zip(joints, fields["lower"], fields["upper"], strict=True):
        if not low < high:
            raise CheckpointError(f"{path}: lower of '{joint}' must be below upper, {high:g}; it is {low:g}")


def _read_json(path: Path, fields: Sequence[str]) -> dict:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise CheckpointError(f"{path}: not valid JSON: {error}") from error
    if not isinstance(content, dict):
        raise CheckpointError(f"{path}: must contain an object, it contains {type(content).__name__}")
    missing = [name for name in fields if name not in content]
    if missing:
        raise CheckpointError(f"{path}: {', '.join(missing)} missing; there are {', '.join(content)}")
    return content


def _write_json(path: Path, content: Mapping) -> None:
    # allow_nan=False, because NaN is not valid JSON.
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _listed(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
