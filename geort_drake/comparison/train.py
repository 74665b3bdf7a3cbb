"""From a robot hand and a recording to an evaluated checkpoint, cached if wanted."""

import contextlib
import dataclasses
import hashlib
import json
import os
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import geort_drake
from geort_drake.comparison.metrics import evaluate
from geort_drake.comparison.versions import git_state, versions
from geort_drake.console import TrainingBars
from geort_drake.errors import CheckpointError, GeortError, HandError, RecordingError, UnknownNameError
from geort_drake.files import digest_of
from geort_drake.hands.canonical import canonical_kinematics, canonical_shapes
from geort_drake.hands.description import HandDescription, load_hand
from geort_drake.hands.model import HandModel
from geort_drake.hands.samples import robot_data
from geort_drake.people.play import synthesize_play
from geort_drake.people.range_of_motion import narrow_motions
from geort_drake.people.readers import read_recording
from geort_drake.people.recording import Recording
from geort_drake.resources import cache_dir
from geort_drake.retargeting.checkpoint import (
    TRAINED_POINTS,
    check_replaceable,
    load_checkpoint,
    save_checkpoint,
)
from geort_drake.retargeting.methods.coupled.training import CoupledConfig, train_coupled
from geort_drake.retargeting.methods.geort import Trainer, TrainingConfig, train_geort
from geort_drake.retargeting.methods.linear_offline import train_linear_offline
from geort_drake.retargeting.retargeter import METHODS as RETARGETERS
from geort_drake.retargeting.retargeter import load_retargeter
from geort_drake.retargeting.trained_space import trained_points
from geort_drake.retargeting.training.descent import Report
from geort_drake.settings import check_names, parse_settings

DEFAULT_METHOD = "geort_coupled"
# Name of a retargeting method → the function that trains it, and the settings it has.
METHODS: dict[str, Trainer] = {
    "geort": train_geort,
    "geort_coupled": train_coupled,
    "linear_offline": train_linear_offline,
}
CONFIGS: dict[str, type[TrainingConfig]] = {
    "geort": TrainingConfig,
    "geort_coupled": CoupledConfig,
    "linear_offline": TrainingConfig,
}
# Methods that learn from labels of collision; for the others they are not computed.
LABELLED = frozenset({"geort"})
# Methods that take the hand's collision shapes.
SHAPED = frozenset({"geort_coupled"})
_PACKAGE = Path(geort_drake.__file__).parent
# The code that decides the weights besides data and settings: training, and the hand's samples and geometry.
TRAINING_CODE = (_PACKAGE / "retargeting", _PACKAGE / "hands")


def training_config(
    method: str, settings: Mapping | None = None, hand: HandDescription | None = None
) -> TrainingConfig:
    """The configuration of a method: its defaults, then what the hand's description sets, then `settings`.

    Raises:
        UnknownNameError: no such method or setting; the message lists those there are.
        HandError: the description's settings are unusable.
        TrainingError: a value makes no sense.
    """
    if method not in METHODS:
        raise UnknownNameError("retargeting method", method, METHODS)
    check_names(settings or {}, CONFIGS[method], method)
    config = CONFIGS[method](**{**(hand_settings(hand, method) if hand else {}), **(settings or {})})
    config.validate()
    return config


def hand_settings(hand: HandDescription, method: str) -> dict[str, Any]:
    """The settings of a method that a hand's description has in place of defaults.

    Raises:
        HandError: those of any method are of no method, or none of the method's, or make no sense.
    """
    settings = {}
    try:
        for of, numbers in hand.training.items():
            if of not in METHODS:
                raise UnknownNameError("retargeting method", of, METHODS)
            texts = [f"{name}={number:.15g}" for name, number in numbers.items()]
            settings[of] = parse_settings(texts, CONFIGS[of], of)
            CONFIGS[of](**settings[of]).validate()
    except GeortError as error:
        raise HandError(f"hand '{hand.name}': training: {error}") from error
    return settings.get(method, {})


def train_checkpoint(
    hand_name: str | os.PathLike,
    recording: Recording | str | os.PathLike | None,
    output: str | os.PathLike,
    method: str = DEFAULT_METHOD,
    seed: int = 0,
    device: str = "cpu",
    show_progress: bool = True,
    settings: Mapping | None = None,
    robot_samples: int = 100_000,
    report: Report | None = None,
) -> Path:
    """Trains a retargeter, evaluates it on the same recording and writes its checkpoint.

    Args:
        hand_name: name or file of a hand description.
        recording: of the person's hand, or its file; None synthesises five minutes of play.
        output: the checkpoint directory, written whole at the end.
        method: name of the retargeting method.
        seed: of everything random: robot samples, synthetic play, training and metrics.
        device: "cpu" or "cuda".
        show_progress: draw progress bars on stderr.
        settings: fields of the method's config that differ from its defaults and the hand's; see `CONFIGS`.
        robot_samples: how many joint positions of the robot are sampled.
        report: see `Report`.

    Returns:
        The checkpoint directory. What the recording lacks and what went wrong in training is in its
        provenance under "warnings", and is warned of as RuntimeWarning at the end.

    Raises:
        HandError, RecordingError, TrainingError, UnknownNameError: something asked for is unusable.
        CheckpointError: `output` exists and is not a checkpoint.
    """
    description = load_hand(hand_name)
    config = training_config(method, settings, description)
    check_replaceable(output)
    hand = HandModel(description)
    kinematics = canonical_kinematics(hand)
    timings: dict[str, float] = {}
    with TrainingBars(show_progress) as bars:
        with _timed(timings, "recording_s"):
            if recording is None:
                recording = synthesize_play(seed, side=description.side)
            recording = training_recording(recording, description.side)
            keypoints = description.human_keypoints
            p_HF = recording.fingertips(keypoints)
            said = narrow_motions(recording.p_HK[recording.valid], keypoints)
        with _timed(timings, "robot_data_s"):
            labels = method in LABELLED
            counter = bars.counter("robot samples")
            samples = robot_data(hand, robot_samples, seed, progress=counter, labels=labels)
        extra: dict[str, object] = {}
        if labels:
            extra["collides_beyond_tips"] = hand.collides_beyond_tips
        if method in SHAPED:
            extra["shapes"] = canonical_shapes(hand)
        with _timed(timings, "fit_s"), _collected(said):
            result = METHODS[method](
                p_HF,
                kinematics,
                samples,
                config,
                seed,
                device,
                report=bars.losses("training", report),
                **extra,
            )
        arrays = result.network.arrays()
        names = (hand.finger_names, hand.joint_names)
        retarget = RETARGETERS[method](arrays, *names, keypoints, hand.lower, hand.upper)
        with _timed(timings, "evaluation_s"), bars.spinner("evaluation"):
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
            "recording": {
                "sha256": recording.digest,
                "frames": len(p_HF),
                "metadata": recording.metadata,
            },
            "robot_data": {
                "count": len(samples.q),
                "seed": seed,
                "model_sha256": samples.digest,
                "labels": labels,
            },
            "seed": seed,
            "warnings": said,
            "versions": versions(),
            "git": git_state(),
            "timings": {key: round(value, 3) for key, value in (timings | result.timings).items()},
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
    for text in said:
        warnings.warn(text, RuntimeWarning, stacklevel=2)
    return path


def cached_checkpoint(
    hand_name: str,
    recording: Recording,
    method: str = DEFAULT_METHOD,
    seed: int = 0,
    device: str = "cpu",
    settings: Mapping | None = None,
    announce: Callable[[], None] | None = None,
) -> tuple[Path, bool]:
    """The checkpoint for a hand and a recording from the cache, trained first if it is not there.

    The key covers the hand's model and description, the recording, method, seed, device, the method's
    settings, and the code of training and hands. A damaged checkpoint is trained again. Warnings of training
    are repeated at every use.

    Args:
        hand_name, recording, method, seed, device, settings: as in `train_checkpoint`.
        announce: called before a training, not if the checkpoint exists.

    Returns:
        The checkpoint's directory in `cache_dir() / "retargeters"`, and whether it existed before.

    Raises:
        HandError, RecordingError, TrainingError, UnknownNameError: see `train_checkpoint`.
    """
    hand = HandModel(load_hand(hand_name))
    config = training_config(method, settings, hand.description)
    facts = {
        "hand": hand.digest,
        "recording": recording.digest,
        "method": method,
        "seed": seed,
        "device": device,
        "training": dataclasses.asdict(config),
        "code": digest_of(_PACKAGE, TRAINING_CODE),
    }
    key = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]
    path = cache_dir() / "retargeters" / f"{hand.description.name}-{method}-{key}"
    if path.is_dir():
        try:
            load_retargeter(path, hand)
            known = load_checkpoint(path).provenance["warnings"]
        except CheckpointError:
            pass  # damaged: train it again
        else:
            for text in known:
                warnings.warn(text, RuntimeWarning, stacklevel=2)
            return path, True
    if announce is not None:
        announce()
    return train_checkpoint(hand_name, recording, path, method, seed, device, settings=settings), False


def training_recording(source: Recording | str | os.PathLike, side: str) -> Recording:
    """A recording of a person's hand, or that of a file, for a robot hand of that side.

    Raises:
        RecordingError: it is of the other hand, or the file is unfit for training.
    """
    if not isinstance(source, Recording):
        return read_recording(source, side=side, training=True)
    if source.side != side:
        raise RecordingError(f"the recording is of a {source.side} hand, the robot's is a {side} hand")
    return source


@contextlib.contextmanager
def _collected(said: list[str]) -> Iterator[None]:
    """Appends the RuntimeWarnings of the block to `said`; warnings of other kinds stay what they are."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")  # what is said at every step counts once
        yield
    for warning in caught:
        if issubclass(warning.category, RuntimeWarning):
            said.append(str(warning.message))
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)


@contextlib.contextmanager
def _timed(timings: dict[str, float], name: str) -> Iterator[None]:
    started = time.perf_counter()
    yield
    timings[name] = time.perf_counter() - started
