"""Several retargeting methods judged on one hand, person and set of metrics."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geort_drake.errors import RecordingError, UnknownNameError
from geort_drake.evaluation import pipeline
from geort_drake.evaluation.checkpoint_cache import cached_checkpoint
from geort_drake.evaluation.metrics import evaluate_frames
from geort_drake.evaluation.versions import versions
from geort_drake.gloves.recording import Recording
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.baselines.online import VectorOnline
from geort_drake.retargeting.baselines.registry import BASELINES, make_baseline
from geort_drake.retargeting.checkpoint import CONFIG
from geort_drake.retargeting.retargeter import load_retargeter

# From a hand's name, recording, method and seed to a checkpoint, and whether it was there already.
Trainer = Callable[..., tuple[Path, bool]]


@dataclass(frozen=True)
class Judged:
    """One method's figures, and where it put the robot's fingertips."""

    metrics: dict  # of `evaluate`, JSON-ready
    remembers: bool  # answers depend on earlier frames
    p_BF: np.ndarray  # (T, F, 3) m, at the scored frames


def method_names() -> tuple[str, ...]:
    """Every method by name: those that are trained, then those that are not."""
    return (*pipeline.METHODS, *BASELINES)


def check_methods(names: Sequence[str]) -> None:
    """Raises UnknownNameError unless every name is a method or a checkpoint's directory."""
    for name in names:
        if name not in method_names() and not (Path(name) / CONFIG).is_file():
            raise UnknownNameError("retargeting method or checkpoint", name, method_names())


def judge(
    name: str,
    hand: HandModel,
    recording: Recording,
    seed: int = 0,
    scored: Recording | None = None,
    frame_limit: int | None = None,
    trainer: Trainer = cached_checkpoint,
) -> Judged:
    """Trains a method where it needs it, and evaluates it.

    A method that optimises online is scored in two ways. Figures over the recorded frames (track,
    coverage, pinch, collision, smoothness, latency) are of its answers to them in their order, from rest.
    Figures that ask about hands which were not recorded are of its settled answers, see
    `VectorOnline.settled_map`.

    Args:
        name: one of `method_names()`, or the directory of a checkpoint for this hand.
        hand: model of the robot hand.
        recording: what the method is trained on.
        seed: of training and metrics.
        scored: what it is scored on; None is the training recording.
        frame_limit: score on the first so many valid frames only.
        trainer: makes the checkpoint of a method that is trained.

    Raises:
        UnknownNameError: no such method.
        RecordingError, CheckpointError, TrainingError: see `evaluate` and `train_checkpoint`.
    """
    check_methods([name])
    description = hand.description
    keypoints = [finger.human_keypoint for finger in description.fingers]
    source = scored or recording
    frames = source.fingertips(keypoints).astype(float)[:frame_limit]
    if len(frames) == 0:
        raise RecordingError("the recording holds no valid frame to score on")
    settled = None
    if name in BASELINES:
        kinematics = hand.kinematics().mirrored() if description.side == "left" else hand.kinematics()
        learned = recording.fingertips(keypoints).astype(float)
        retarget = make_baseline(name, kinematics, keypoints, frames=learned, seed=seed)
    elif name in pipeline.METHODS:
        path, _ = trainer(description.name, recording, method=name, seed=seed)
        retarget = load_retargeter(path, hand)
    else:
        retarget = load_retargeter(name, hand)
    remembers = isinstance(retarget, VectorOnline)
    if isinstance(retarget, VectorOnline):
        settled = retarget.settled_map(frames)
        retarget.reset()
    metrics = evaluate_frames(retarget, hand, frames, source.rate_hz, seed, settled)
    if isinstance(retarget, VectorOnline):
        retarget.reset()
    p_BF = hand.fingertips(retarget(frames))
    if description.side == "left":
        p_BF = p_BF * [1.0, -1.0, 1.0]
    return Judged(_finite(metrics), remembers, p_BF)


def report(
    results: Mapping[str, Judged], hand: HandModel, recording: Recording, seed: int, scored: Recording
) -> dict:
    """The results as one JSON-ready dictionary: `methods` → metrics, and what they were measured on."""
    return {
        "hand": hand.description.name,
        "hand_sha256": hand.digest,
        "recording_sha256": recording.digest,
        "scored_on_sha256": scored.digest,
        "frames": min((len(judged.p_BF) for judged in results.values()), default=0),
        "seed": seed,
        "versions": versions(),
        "methods": {
            name: {"remembers": judged.remembers, **judged.metrics} for name, judged in results.items()
        },
    }


def _finite(value):
    """The same with None for numbers that JSON cannot hold."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
