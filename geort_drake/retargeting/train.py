"""Trains the map of one person on a recording, and keeps trained maps in a cache."""

import dataclasses
import hashlib
import itertools
import json
import math
import os
import time
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geort_drake.console import progress_bar, say
from geort_drake.errors import MapError, TrainingError, UnknownNameError
from geort_drake.files import locked, require_writable, source_digest
from geort_drake.people.checks import require_hand
from geort_drake.people.coverage import describe, finger_motions
from geort_drake.people.readers import read_recording
from geort_drake.people.recording import PINCH_M, Recording
from geort_drake.people.synthetic.play import synthesize_play
from geort_drake.resources import cache_dir
from geort_drake.retargeting import DEFAULT_METHOD, METHODS
from geort_drake.retargeting.base import Retargeter
from geort_drake.retargeting.clouds import trained_points, voxel_thinned
from geort_drake.retargeting.store import SUFFIX, load_retargeter
from geort_drake.settings import check_names
from geort_drake.versions import git_state, versions

if TYPE_CHECKING:
    from geort_drake.hands.hand import Hand

_VOXEL, _MIN_PLACES = 0.001, 50  # m; places that a fingertip must visit


def training_config(method: str, settings: Mapping | None = None) -> Any:
    """Returns the settings of a method's training: its defaults, overridden by `settings`.

    Raises:
        UnknownNameError: there is no such method or setting; the message lists the known ones.
        TrainingError: the method is not trained, a number is negative or not finite, or a count is 0.
    """
    if method not in METHODS:
        raise UnknownNameError("retargeting method", method, METHODS)
    if not METHODS[method].is_trained:
        raise TrainingError(f"{method} is not trained on a recording; it needs no map of its own")
    config = METHODS[method].config()
    check_names(settings or {}, type(config), method)
    config = dataclasses.replace(config, **(settings or {}))
    for name, value in dataclasses.asdict(config).items():
        default = getattr(type(config), name)
        if isinstance(default, str):
            continue
        if not isinstance(value, int | float):
            raise TrainingError(f"settings of {method}: {name} must be a number, it is '{value}'")
        least = 1 if isinstance(default, int) else 0
        if not (math.isfinite(value) and value >= least):
            raise TrainingError(f"settings of {method}: {name} must be at least {least}, it is {value}")
    return config


def train_map(
    hand: "Hand",
    recording: Recording | str | os.PathLike | None,
    method: str = DEFAULT_METHOD,
    seed: int = 0,
    device: str = "cpu",
    settings: Mapping | None = None,
    show_progress: bool = True,
) -> Retargeter:
    """Trains a map on a recording.

    Args:
        hand: model of the robot hand.
        recording: recording of the person's hand, or its file; None synthesises five minutes of play.
        method: name of a trained method.
        seed: seed of robot samples, synthetic play and training.
        device: "cpu" or "cuda".
        settings: settings of the method that differ from its defaults.
        show_progress: draw a progress bar on stderr.

    Returns:
        The map; its `info` has the settings, the losses and the origin. Warnings about the recording are
        issued as RuntimeWarning at the end, and are under "warnings" in the provenance.

    Raises:
        RecordingError, TrainingError, UnknownNameError: an argument is unusable, or the loss is not finite.
    """
    config = training_config(method, settings)
    recording = training_recording(recording, hand.description.side, seed)
    keypoints = hand.description.human_keypoints
    p_HF = recording.fingertips(keypoints)
    motions = finger_motions(recording.p_HK[recording.valid], keypoints)
    messages = [
        f"narrow motion, {describe(each)}; {each['advice']}" for each in motions if not each["enough"]
    ]
    messages += check_fingertips(p_HF, hand.finger_names)
    started = time.perf_counter()
    with progress_bar(show_progress) as bars:
        retargeter = METHODS[method].fit(
            hand, p_HF, seed=seed, config=config, device=device, report=bars.losses("training")
        )
    retargeter.robot_hands = (hand.description.name,)
    retargeter.trained_points = trained_points(p_HF)
    retargeter.info |= {
        "method": method,
        "config": {**dataclasses.asdict(config), "seed": seed, "device": device},
        "provenance": {
            "recording": {
                "sha256": recording.digest,
                "frames": len(p_HF),
                "metadata": recording.metadata,
            },
            "hands": {hand.description.name: hand.digest},
            "warnings": messages,
            "versions": versions(),
            "git": git_state(),
            "seconds": round(time.perf_counter() - started, 3),
        },
    }
    for text in messages:
        warnings.warn(text, RuntimeWarning, stacklevel=2)
    return retargeter


def cached_map(
    hand: "Hand",
    recording: Recording,
    method: str = DEFAULT_METHOD,
    seed: int = 0,
    device: str = "cpu",
    settings: Mapping | None = None,
) -> tuple[Retargeter, Path]:
    """Returns the cached map for a hand and a recording, and its file; trains it first if it is missing.

    The key covers the hand's model and description, the recording, method, seed, device, settings, and the
    code of `retargeting` and `hands`. A line on stderr announces a training. Warnings of the training are
    repeated at every use.

    Args:
        hand, recording, method, seed, device, settings: as in `train_map`.

    Raises:
        RecordingError, TrainingError, UnknownNameError: as in `train_map`.
    """
    facts = {
        "hand": hand.digest,
        "recording": recording.digest,
        "method": method,
        "seed": seed,
        "device": device,
        "settings": dataclasses.asdict(training_config(method, settings)),
        "code": source_digest("retargeting", "hands"),
    }
    key = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]
    path = cache_dir() / "retargeters" / f"{hand.description.name}-{method}-{key}{SUFFIX}"
    if (retargeter := _load_cached(path, hand)) is not None:
        return retargeter, path
    require_writable(path)
    say(
        f"The cache has no {method} map for {hand.description.name} and this recording; training one "
        "takes minutes."
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked(path.with_name(f".{path.name}.lock"), wait=True):
        # Another process may have trained it meanwhile.
        if (retargeter := _load_cached(path, hand)) is None:
            train_map(hand, recording, method, seed, device, settings).save(path)
            retargeter = load_retargeter(path, hand)
    return retargeter, path


def _load_cached(path: Path, hand: "Hand") -> Retargeter | None:
    """Returns the undamaged map in a file, and repeats the warnings of its training; or None."""
    try:
        retargeter = load_retargeter(path, hand)
    except MapError:
        return None
    for text in retargeter.info["provenance"]["warnings"]:
        warnings.warn(text, RuntimeWarning, stacklevel=3)
    return retargeter


def training_recording(source: Recording | str | os.PathLike | None, side: str, seed: int = 0) -> Recording:
    """Returns the training recording for a robot hand of `side`: given, read from a file, or synthesised.

    Raises:
        RecordingError, MismatchError: the recording is of the other hand, is no person's (see
            `require_hand`), or the file is unsuitable for training.
    """
    if source is None:
        return synthesize_play(seed, side=side)
    if not isinstance(source, Recording):
        return read_recording(source, side=side, training=True)
    require_hand(source, side)
    return source


def check_fingertips(p_HF: np.ndarray, finger_names: Sequence[str]) -> list[str]:
    """Checks the fingertips (T, F, 3), m, of a recording; returns what may spoil the map, in sentences.

    Raises:
        TrainingError: a finger hardly moves, or no pair of fingertips ever pinches.
    """
    for row, name in enumerate(finger_names):
        places = len(voxel_thinned(p_HF[:, row], _VOXEL))
        if places < _MIN_PLACES:
            raise TrainingError(
                f"the recording's {name} tip visits only {places} places {1000 * _VOXEL:g} mm apart; at "
                f"least {_MIN_PLACES} are needed, preferably thousands"
            )
    pairs = list(itertools.combinations(range(len(finger_names)), 2))
    if "thumb" in finger_names:
        thumb = list(finger_names).index("thumb")
        pairs = [pair for pair in pairs if thumb in pair]
    if not pairs:
        return []
    first, second = zip(*pairs, strict=True)
    nearest = np.linalg.norm(p_HF[:, list(first)] - p_HF[:, list(second)], axis=-1).min(axis=0)
    if nearest.min() >= PINCH_M:
        raise TrainingError(
            f"the recording contains no pinch: the thumb's tip should come nearer than {1000 * PINCH_M:.0f} "
            f"mm to another fingertip, the nearest is {1000 * nearest.min():.0f} mm; record pinches"
        )
    return [
        f"the recording contains no pinch of the {finger_names[i]} with the {finger_names[j]} (nearest "
        f"{1000 * distance:.0f} mm); such pinches of the robot may not close"
        for (i, j), distance in zip(pairs, nearest, strict=True)
        if distance >= PINCH_M and "thumb" in finger_names
    ]
