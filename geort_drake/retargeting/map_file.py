"""Files of universal maps: their weights, robot hands and origin.

A map is a single safetensors file. Its header contains the format and, as JSON, hands (name → digest of the
model), finger_names, joint_names, human_keypoints, lower, upper, training and provenance.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save

from geort_drake.errors import CheckpointError
from geort_drake.files import atomic_path
from geort_drake.resources import models_dir
from geort_drake.retargeting.checkpoint import TrainedHand, check_map

FORMAT = "1"
SUFFIX = ".safetensors"
MAX_BYTES = 1 << 20
_FIELDS = (
    "hands", "finger_names", "joint_names", "human_keypoints", "lower", "upper", "training", "provenance",
)  # fmt: skip


@dataclass(frozen=True)
class MapFile:
    """Contents of a map's file.

    Attributes:
        arrays: arrays of `UniversalRetargeter`.
        hands: name → model digest of each robot hand for which the map was made. A left hand that mirrors a
            right one has the same map.
        finger_names, joint_names, human_keypoints, lower, upper: as in `UniversalRetargeter`.
        training, provenance: settings and origin; JSON types only.
    """

    arrays: Mapping[str, np.ndarray]
    hands: Mapping[str, str]
    finger_names: Sequence[str]
    joint_names: Sequence[str]
    human_keypoints: Sequence[int]
    lower: Sequence[float]
    upper: Sequence[float]
    training: Mapping
    provenance: Mapping

    def save(self, path: str | os.PathLike) -> None:
        """Writes the file atomically, with numbers in single precision.

        Raises:
            CheckpointError: the file would be larger than 1 MiB.
            OutputError: the file cannot be written.
        """
        arrays = {
            name: np.ascontiguousarray(array, dtype=np.int64 if name == "columns" else np.float32)
            for name, array in self.arrays.items()
        }
        header = {name: json.dumps(_plain(getattr(self, name)), allow_nan=False) for name in _FIELDS}
        contents = save(arrays, {"format": FORMAT} | header)
        if len(contents) > MAX_BYTES:
            raise CheckpointError(f"{path}: a map must have at most {MAX_BYTES} bytes, not {len(contents)}")
        with atomic_path(path) as draft:
            draft.write_bytes(contents)

    def check_hand(self, path: str | os.PathLike, hand: TrainedHand) -> None:
        """Raises CheckpointError, which names `path`, unless the map is for `hand`."""
        given = (tuple(hand.joint_names), tuple(hand.finger_names))
        if given != (tuple(self.joint_names), tuple(self.finger_names)) or (
            hand.digest not in self.hands.values()
        ):
            raise CheckpointError(
                f"{path}: the map is for another hand, or for another version of its model: it is for "
                f"{', '.join(self.hands)}; make one for this hand with geort-drake pretrain"
            )


def load_map(path: str | os.PathLike) -> MapFile:
    """Reads a map's file.

    Raises:
        CheckpointError: the file is missing, too large or malformed, or of another format.
    """
    path = Path(path)
    if not path.is_file():
        raise CheckpointError(f"{path}: no such map file")
    if (size := path.stat().st_size) > MAX_BYTES:
        raise CheckpointError(f"{path}: a map has at most {MAX_BYTES} bytes, this file has {size}")
    try:
        with safe_open(path, "numpy") as file:
            header = file.metadata() or {}
            arrays = {name: file.get_tensor(name) for name in file.keys()}
    except Exception as error:  # safetensors raises exceptions of its own and built-in ones
        raise CheckpointError(f"{path}: not a safetensors file: {error}") from error
    if header.get("format") != FORMAT:
        raise CheckpointError(f"{path}: format is {header.get('format')}, this version reads {FORMAT}")
    if missing := [name for name in _FIELDS if name not in header]:
        raise CheckpointError(f"{path}: {', '.join(missing)} missing; there are {', '.join(header)}")
    try:
        fields = {name: json.loads(header[name]) for name in _FIELDS}
    except (ValueError, RecursionError) as error:
        raise CheckpointError(f"{path}: the header is not valid JSON: {error}") from error
    for name in ("hands", "training", "provenance"):
        if not isinstance(fields[name], dict):
            raise CheckpointError(f"{path}: {name} has a wrong type, {type(fields[name]).__name__}")
    check_map(path, fields)
    return MapFile(arrays, **fields)


def shipped_maps() -> dict[str, Path]:
    """Returns the maps shipped with the package: name of the robot hand → file."""
    return {
        hand: path
        for path in sorted((models_dir() / "maps").glob(f"*{SUFFIX}"))
        for hand in load_map(path).hands
    }


def _plain(value: object) -> object:
    """Converts arrays, mappings and sequences to JSON types."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    return list(value) if isinstance(value, Sequence) else value
