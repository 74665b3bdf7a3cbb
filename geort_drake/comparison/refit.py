"""Re-fits a checkpoint to another person, from a recording to an evaluated checkpoint."""

import os
import time
from pathlib import Path

from geort_drake.comparison.metrics import evaluate
from geort_drake.comparison.train import training_recording
from geort_drake.comparison.versions import versions
from geort_drake.errors import CheckpointError
from geort_drake.files import sha256_of
from geort_drake.hands.description import load_hand
from geort_drake.hands.mirror import canonical_kinematics, canonical_shapes
from geort_drake.hands.model import HandModel
from geort_drake.hands.samples import robot_data
from geort_drake.people.recording import Recording
from geort_drake.retargeting.affine_refit import fit_affine, folded
from geort_drake.retargeting.checkpoint import (
    TRAINED_POINTS,
    WEIGHTS,
    check_replaceable,
    load_checkpoint,
    save_checkpoint,
)
from geort_drake.retargeting.method import TrainingData
from geort_drake.retargeting.methods import trained_method
from geort_drake.retargeting.methods.coupled import FINE_TUNING_STEPS
from geort_drake.retargeting.trained_space import trained_points
from geort_drake.retargeting.training.descent import Report


def refit_checkpoint(
    checkpoint: str | os.PathLike,
    recording: Recording | str | os.PathLike,
    output: str | os.PathLike,
    hand_name: str | os.PathLike | None = None,
    steps: int = FINE_TUNING_STEPS,
    seed: int = 0,
    report: Report | None = None,
) -> Path:
    """Fits a checkpoint to another person and writes a new checkpoint.

    Args:
        checkpoint: directory of the checkpoint to start from.
        recording: about a minute of the new person's hand, or its file.
        output: the new checkpoint's directory.
        hand_name: name or file of the robot hand's description; None: the name in the checkpoint.
        steps: of the fine-tuning, which only geort_coupled has; 0 for none.
        seed: of the fine-tuning and of the metrics.
        report: see `Report`.

    Returns:
        The new checkpoint's directory. Its provenance has the time of the fit under "timings".

    Raises:
        CheckpointError: the checkpoint is damaged, for another hand, or lacks the fingertips of its training.
        UnknownNameError: this version does not know its method.
        RecordingError, TrainingError: the recording is unsuitable.
    """
    check_replaceable(output)
    old = load_checkpoint(checkpoint)
    space = old.trained_space
    if space is None:
        raise CheckpointError(
            f"{old.path}: lacks the fingertips of its training, as checkpoints before version 0.2 do; "
            "train a new one"
        )
    method = trained_method(old.config["method"])
    hand = HandModel(load_hand(hand_name or old.hand["name"]))
    old.check_hand(hand)
    recording = training_recording(recording, hand.description.side)
    p_HF = recording.fingertips(old.config["human_keypoints"])
    started = time.perf_counter()
    maps = fit_affine(space, p_HF, old.config["finger_names"])
    weights = folded({name: array for name, array in old.arrays.items() if name != TRAINED_POINTS}, maps)
    timings = {"affine_s": time.perf_counter() - started}
    history: list[dict[str, float]] = []
    steps = steps if method.fine_tune is not None else 0
    if method.fine_tune is not None and steps > 0:
        # The same robot samples as in the training.
        sampled = old.provenance.get("robot_data", {})
        kept = {key: sampled[key] for key in ("count", "seed") if key in sampled}
        data = TrainingData(
            p_HF,
            canonical_kinematics(hand),
            robot_data(hand, **kept, labels=False).q,
            shapes=lambda: canonical_shapes(hand),
        )
        result = method.fine_tune(weights, data, old.config["training"], steps, seed, report)
        weights, history = result.network.arrays(), result.history
        timings["fine_tuning_s"] = time.perf_counter() - started - timings["affine_s"]
    timings["fit_s"] = time.perf_counter() - started
    provenance = {
        **old.provenance,
        "recording": {"sha256": recording.digest, "frames": len(p_HF), "metadata": recording.metadata},
        "seed": seed,
        "versions": versions(),
        "timings": {name: round(value, 3) for name, value in timings.items()},
        "refit": {
            "from_weights_sha256": sha256_of(old.path / WEIGHTS),
            "from_recording": old.provenance.get("recording"),
            "steps": steps,
            "affine": {
                finger: {"A": A.tolist(), "b": b.tolist(), "miss_mm": round(1e3 * float(miss), 3)}
                for finger, A, b, miss in zip(
                    old.config["finger_names"], maps.A, maps.b, maps.miss, strict=True
                )
            },
        },
    }
    names = old.config["finger_names"], old.config["joint_names"], old.config["human_keypoints"]
    retarget = method.retargeter(weights, *names, hand.lower, hand.upper)
    metrics = evaluate(retarget, hand, recording, seed)
    return save_checkpoint(
        output,
        {**weights, TRAINED_POINTS: trained_points(p_HF)},
        method=method.name,
        hand=old.hand,
        human_keypoints=names[2],
        training=old.config.get("training", {}),
        provenance=provenance,
        history=history,
        metrics={"hand": old.hand["name"], "recording_sha256": recording.digest, "seed": seed, **metrics},
    )
