"""Checkpoints that must not drive a hand; forged ones have digests that agree."""

import json
import os
import pickle
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file, save_file

from faults.refusals import Case
from faults.sound import checkpoint
from geort_drake.files import sha256_of
from geort_drake.retargeting.retargeter import load_retargeter

WEIGHTS = "weights.safetensors"


def changed(change: Callable[[Path], None], forged: bool = False) -> Callable[[Path], tuple]:
    """A checkpoint after `change`, with digests that agree where it is forged."""

    def make(folder: Path) -> tuple:
        path = checkpoint(folder)
        change(path)
        if forged:
            config = json.loads((path / "config.json").read_text())
            for name in config["sha256"]:
                config["sha256"][name] = sha256_of(path / name)
            (path / "config.json").write_text(json.dumps(config))
        return load_retargeter, path

    return make


def config(**changes: object) -> Callable[[Path], tuple]:
    def change(path: Path) -> None:
        stored = json.loads((path / "config.json").read_text())
        (path / "config.json").write_text(json.dumps(stored | changes))

    return changed(change)


def hand(**changes: object) -> Callable[[Path], tuple]:
    def change(path: Path) -> None:
        stored = json.loads((path / "hand.json").read_text())
        (path / "hand.json").write_text(json.dumps(stored | changes))

    return changed(change, forged=True)


def weights(**changes: np.ndarray) -> Callable[[Path], tuple]:
    return changed(lambda path: save_file(load_file(path / WEIGHTS) | changes, path / WEIGHTS), forged=True)


def written(name: str, content: bytes) -> Callable[[Path], tuple]:
    return changed(lambda path: (path / name).write_bytes(content) and None, forged=name != "config.json")


def header(content: bytes, length: int | None = None) -> bytes:
    """A safetensors file of that header."""
    return struct.pack("<Q", len(content) if length is None else length) + content


def grown(path: Path) -> None:
    """Weights of 40 GiB that take no place on the disk."""
    with (path / WEIGHTS).open("ab") as file:
        file.truncate(40 << 30)


def pipe(path: Path) -> None:
    (path / "hand.json").unlink()
    os.mkfifo(path / "hand.json")


def outside(path: Path) -> None:
    """Digests of files that are not the checkpoint's."""
    stored = json.loads((path / "config.json").read_text())
    stored["sha256"]["../../../../etc/passwd"] = "0" * 64
    (path / "config.json").write_text(json.dumps(stored))


_HUGE = json.dumps({"weight0": {"dtype": "F64", "shape": [10**9, 10**9], "data_offsets": [0, 8]}}).encode()
_PAST = json.dumps({"weight0": {"dtype": "F64", "shape": [9], "data_offsets": [0, 72]}}).encode()

_MAKERS: dict[str, tuple[Callable[[Path], tuple], str]] = {
    "weights that are a pickle": (
        written(WEIGHTS, pickle.dumps({"weight0": [1.0]})),
        "not a safetensors file",
    ),
    "weights of a huge shape": (written(WEIGHTS, header(_HUGE) + bytes(8)), "not a safetensors file"),
    "weights past the end": (written(WEIGHTS, header(_PAST) + bytes(8)), "not a safetensors file"),
    "weights with an endless header": (written(WEIGHTS, header(b"{}", 1 << 60)), "not a safetensors file"),
    "weights without a header": (written(WEIGHTS, b""), "not a safetensors file"),
    "weights of 40 GiB": (changed(grown), "weights.safetensors: holds 40.0 GiB"),
    "weights that are not finite": (weights(weight1=np.full((4, 8, 8), np.nan)), "'weight1' must be finite"),
    "weights of another hand's size": (
        weights(weight2=np.zeros((5, 8, 4))),
        "'weight2' must be finite and of",
    ),
    "columns that are fractions": (weights(columns=np.arange(16) + 0.5), "columns must be"),
    "columns out of range": (weights(columns=np.arange(16) + 1), "columns must be"),
    "trained points that are not finite": (
        weights(trained_points=np.full((4, 2, 3), np.inf, np.float32)),
        "trained points must be finite",
    ),
    "a hand that is a pipe": (changed(pipe), "hand.json missing"),
    "digests of files elsewhere": (changed(outside), r"sha256 names .*/etc/passwd"),
    "digests that are a list": (config(sha256=["0"]), "sha256 must be"),
    "JSON 100,000 deep": (written("config.json", b"[" * 100_000), "not valid JSON"),
    "JSON in another encoding": (written("hand.json", "ä".encode("utf-16")), "not valid JSON"),
    "a method that is a list": (config(method=["geort"]), "method must be a text"),
    "fingers that are a number": (config(finger_names=4), "finger_names must be"),
    "keypoints that are texts": (config(human_keypoints=["a", "b", "c", "d"]), "human_keypoints must be"),
    "keypoints that no hand has": (config(human_keypoints=[4, 8, 12, 99]), "human_keypoints must be"),
    "weights whose products overflow": (
        weights(weight1=np.full((4, 8, 8), 1e200)),
        r"'weight1' must be within ±1e\+06, it has 1e\+200",
    ),
    "weights that are no numbers": (
        weights(weight1=np.zeros((4, 8, 8), bool)),
        "'weight1' must be .* of bool",
    ),
    "networks without a hidden unit": (
        weights(
            weight0=np.zeros((4, 3, 0)),
            bias0=np.zeros((4, 1, 0)),
            weight1=np.zeros((4, 0, 0)),
            bias1=np.zeros((4, 1, 0)),
            weight2=np.zeros((4, 0, 4)),
        ),
        r"'weight0' must be finite and of shape \(4, 3, -1\), it has \(4, 3, 0\)",
    ),
    "limits that are not finite": (
        hand(lower=[float("nan")] * 16),
        "lower of 'joint_12' must be a number within ±100 rad, not nan",
    ),
    "limits the wrong way round": (hand(lower=[3.0] * 16), "lower of 'joint_12' must be below upper"),
    "limits for fewer joints": (hand(upper=[1.0] * 15), "upper must be a list of 16 numbers"),
    "limits that are texts": (hand(upper=["1.0"] * 16), "upper of 'joint_12' must be a number"),
    "limits whose difference overflows": (
        hand(lower=[-1.7e308] * 16, upper=[1.7e308] * 16),
        r"lower of 'joint_12' must be a number within ±100 rad, not -1\.7e\+308",
    ),
    "limits larger than any float": (hand(upper=[10**400] * 16), "upper of 'joint_12' must be a number"),
    "joint names that are numbers": (
        hand(joint_names=list(range(16))),
        "joint_names differ: hand.json has 0, 1",
    ),
    "joint names of half a character": (
        config(joint_names=["\ud800"] * 16),
        r"joint_names differ: .* has \\ud800",
    ),
    "an older format of the future": (config(format="2"), "format is 2, this version reads 1"),
}

CASES = [Case("checkpoint", name, make, "CheckpointError", says) for name, (make, says) in _MAKERS.items()]
