"""Trains a retargeter on a recording and writes an evaluated checkpoint, optionally to a cache."""

import contextlib
import dataclasses
import hashlib
import json
import os
import time
import warnings
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geort_drake.comparison.metrics import evaluate
from geort_drake.console import progress_bar, say
from geort_drake.errors import CheckpointError, RecordingError
from geort_drake.files import locked, require_writable, reserved, source_digest
from geort_drake.hands.collision_shapes import canonical_shapes
from geort_drake.hands.description import HandDescription, load_hand
from geort_drake.hands.hand import canonical_kinematics
from geort_drake.hands.model import HandModel
from geort_drake.people.coverage import finger_motions
from geort_drake.people.play import synthesize_play
from geort_drake.people.readers import read_recording
from geort_drake.people.recording import Recording
from geort_drake.resources import cache_dir
from geort_drake.retargeting.checkpoint import (
    TRAINED_POINTS,
    check_replaceable,
    load_checkpoint,
    save_checkpoint,
)
from geort_drake.retargeting.method import TrainingConfig, TrainingData
from geort_drake.retargeting.methods import DEFAULT_METHOD, trained_method
from geort_drake.retargeting.methods.coupled import Start
from geort_drake.retargeting.retargeter import load_retargeter
from geort_drake.retargeting.trained_space import trained_points
from geort_drake.settings import check_names
from geort_drake.versions import git_state, versions

if TYPE_CHECKING:
    from geort_drake.retargeting.training.descent import Report

_CHECKPOINT_BYTES = 1 << 20  # more than a checkpoint with default settings has


def training_config(method: str, settings: Mapping | None = None) -> TrainingConfig:
    """Returns the configuration of a method: its defaults, overridden by `settings`.

    Raises:
        UnknownNameError: there is no such method or setting; the message lists the known ones.
        TrainingError: a value is invalid.
    """
    kind = trained_method(method).config
    check_names(settings or {}, kind, method)
    config = kind(**(settings or {}))
    config.validate()
    return config


def train_checkpoint(
    hand_name: str | os.PathLike | HandDescription,
    recording: Recording | str | os.PathLike | None,
    output: str | os.PathLike,
    method: str = DEFAULT_METHOD,
    seed: int = 0,
    device: str = "cpu",
    show_progress: bool = True,
    settings: Mapping | None = None,
    robot_samples: int = 100_000,
    report: "Report | None" = None,
    start: Start | None = None,
    provenance: Mapping | None = None,
) -> Path:
    """Trains a retargeter, evaluates it on the same recording and writes its checkpoint.

    Args:
        hand_name: a hand description, or its name or file.
        recording: recording of the person's hand, or its file; None synthesises five minutes of play.
        output: path of the checkpoint directory, written at the end.
        method: name of the retargeting method.
        seed: seed of robot samples, synthetic play, training and metrics.
        device: "cpu" or "cuda".
        show_progress: draw progress bars on stderr.
        settings: fields of the method's config that differ from its defaults.
        robot_samples: number of sampled joint positions of the robot.
        report: see `Report`.
        start: start of a training by `geort_coupled`; None starts from random weights.
        provenance: additional entries of the checkpoint's provenance.

    Returns:
        The checkpoint directory. Its provenance has warnings about the recording and the training under
        "warnings"; they are also issued as RuntimeWarning at the end.

    Raises:
        HandError, RecordingError, TrainingError, UnknownNameError: an argument is unusable.
        CheckpointError: `output` exists and is not a checkpoint.
        OutputError: `output` cannot be written; found before the training.
    """
    description = load_hand(hand_name)
    config = training_config(method, settings)
    check_replaceable(output)
    require_writable(output, directory=True)
    hand = HandModel(description)
    with reserved(output, _CHECKPOINT_BYTES), progress_bar(show_progress) as bars:
        recording = training_recording(recording, description.side, seed)
        keypoints = description.human_keypoints
        p_HF = recording.fingertips(keypoints)
        motions = finger_motions(recording.p_HK[recording.valid], keypoints)
        messages = [f"narrow motion, {each}; {each.advice}" for each in motions if not each.enough]
        q = hand.sample(robot_samples, seed)
        data = TrainingData(
            p_HF,
            canonical_kinematics(hand),
            q,
            partial(hand.collides_beyond_tips, q),
            hand.collides_beyond_tips,
            partial(canonical_shapes, hand),
        )
        trained = trained_method(method)
        train = trained.train if start is None else partial(trained.train, start=start)
        started = time.perf_counter()
        with _collect_warnings(messages):
            result = train(data, config, seed, device, bars.losses("training", report))
        timings = {"fit_s": time.perf_counter() - started, **result.timings}
        arrays = result.network.arrays()
        names = (hand.finger_names, hand.joint_names)
        retarget = trained.retargeter(arrays, *names, keypoints, hand.lower, hand.upper)
        with bars.spinner("evaluation"):
            metrics = evaluate(retarget, hand, recording, seed)
    metrics = {"hand": description.name, "recording_sha256": recording.digest, "seed": seed, **metrics}
    if result.neural_kinematics:
        metrics["neural_kinematics"] = result.neural_kinematics
    path = save_checkpoint(
        output,
        {**arrays, TRAINED_POINTS: trained_points(p_HF)},
        method=method,
        hand={
            "name": description.name,
            "side": description.side,
            "finger_names": list(hand.finger_names),
            "joint_names": list(hand.joint_names),
            "lower": np.asarray(hand.lower).tolist(),
            "upper": np.asarray(hand.upper).tolist(),
            "model_sha256": hand.digest,
        },
        human_keypoints=keypoints,
        training={**dataclasses.asdict(config), "seed": seed, "device": device},
        provenance={
            **(provenance or {}),
            "recording": {
                "sha256": recording.digest,
                "frames": len(p_HF),
                "metadata": recording.metadata,
            },
            "robot_data": {"count": len(q), "seed": seed, "model_sha256": hand.digest},
            "seed": seed,
            "warnings": messages,
            "versions": versions(),
            "git": git_state(),
            "timings": {key: round(value, 3) for key, value in timings.items()},
            "training": {
                "classifier": result.classifier,
                "neural_kinematics": result.neural_kinematics,
                "human_points": result.human_points,
                "pinch_frames": result.pinch_frames,
                "stopped_at": result.stopped_at,
            },
        },
        history=result.history,
        metrics=metrics,
    )
    for text in messages:
        warnings.warn(text, RuntimeWarning, stacklevel=2)
    return path


def cached_checkpoint(
    hand_name: str | os.PathLike | HandDescription,
    recording: Recording,
    method: str = DEFAULT_METHOD,
    seed: int = 0,
    device: str = "cpu",
    settings: Mapping | None = None,
) -> Path:
    """Returns the cached checkpoint for a hand and a recording; trains it first if it is missing or damaged.

    The key covers the hand's model and description, the recording, method, seed, device, settings, and the
    code of `retargeting` and `hands`. A line on stderr announces a training. Warnings of the training are
    repeated at every use.

    Args:
        hand_name, recording, method, seed, device, settings: as in `train_checkpoint`.

    Returns:
        The checkpoint directory in `cache_dir() / "retargeters"`.

    Raises:
        HandError, RecordingError, TrainingError, UnknownNameError: as in `train_checkpoint`.
    """
    hand = HandModel(hand_name)
    config = training_config(method, settings)
    facts = {
        "hand": hand.digest,
        "recording": recording.digest,
        "method": method,
        "seed": seed,
        "device": device,
        "training": dataclasses.asdict(config),
        "code": source_digest("retargeting", "hands"),
    }
    key = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]
    path = cache_dir() / "retargeters" / f"{hand.description.name}-{method}-{key}"
    if _is_usable(path, hand):
        return path
    say(
        f"The cache has no {method} retargeter for {hand.description.name} and this recording; training one "
        "takes about two minutes."
    )
    with locked(path.with_name(f".{path.name}.lock"), wait=True):
        # Another process may have trained it meanwhile.
        if not _is_usable(path, hand):
            train_checkpoint(hand_name, recording, path, method, seed, device, settings=settings)
    return path


def _is_usable(path: Path, hand: HandModel) -> bool:
    """Whether there is an undamaged checkpoint for the hand; repeats the warnings of its training."""
    try:
        load_retargeter(path, hand)
        known = load_checkpoint(path).provenance["warnings"]
    except CheckpointError:
        return False
    for text in known:
        warnings.warn(text, RuntimeWarning, stacklevel=3)
    return True


def training_recording(source: Recording | str | os.PathLike | None, side: str, seed: int = 0) -> Recording:
    """Returns the training recording for a robot hand of `side`: given, read from a file, or synthesised.

    Raises:
        RecordingError: the recording is of the other hand, or the file is unsuitable for training.
    """
    if source is None:
        return synthesize_play(seed, side=side)
    if not isinstance(source, Recording):
        return read_recording(source, side=side, training=True)
    if source.side != side:
        raise RecordingError(f"the recording is of a {source.side} hand, the robot's is a {side} hand")
    return source


@contextlib.contextmanager
def _collect_warnings(messages: list[str]) -> Iterator[None]:
    """Appends the RuntimeWarnings of the block to `messages`; issues all other warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")  # a warning that occurs at every step is kept once
        yield
    for warning in caught:
        if issubclass(warning.category, RuntimeWarning):
            messages.append(str(warning.message))
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
