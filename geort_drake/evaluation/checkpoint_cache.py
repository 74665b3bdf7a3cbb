"""Trained retargeters kept for the next run, under a key made of everything that decides them."""

import dataclasses
import hashlib
import json
from pathlib import Path

import geort_drake.retargeting
from geort_drake.errors import CheckpointError
from geort_drake.evaluation.pipeline import train_checkpoint
from geort_drake.files import sha256_of
from geort_drake.gloves.recording import Recording
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.resources import cache_dir
from geort_drake.retargeting.retargeter import load_retargeter
from geort_drake.retargeting.training import TrainingConfig


def cached_checkpoint(
    hand_name: str, recording: Recording, method: str = "geort", seed: int = 0, device: str = "cpu"
) -> tuple[Path, bool]:
    """The checkpoint for a hand and a recording, trained now unless an equal one is at hand.

    The key covers the hand's model and description, the recording's contents, method, seed, device,
    training settings and the training code, so a change in any of them trains anew. A damaged
    checkpoint is trained again.

    Returns:
        The checkpoint's directory in `cache_dir() / "retargeters"`, and whether it was there already.

    Raises:
        HandError, RecordingError, TrainingError, UnknownNameError: see `train_checkpoint`.
    """
    hand = HandModel(load_hand(hand_name))
    facts = {
        "hand": hand.digest,
        "recording": recording.digest,
        "method": method,
        "seed": seed,
        "device": device,
        "training": dataclasses.asdict(TrainingConfig()),
        "code": _code_digest(),
    }
    key = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]
    path = cache_dir() / "retargeters" / f"{hand.description.name}-{method}-{key}"
    if path.is_dir():
        try:
            load_retargeter(path, hand)
            return path, True
        except CheckpointError:
            pass  # damaged: train it again
    return train_checkpoint(hand_name, recording, path, method, seed, device), False


def _code_digest() -> str:
    """SHA-256 over the sources of the training package."""
    folder = Path(geort_drake.retargeting.__file__).parent
    digests = [sha256_of(source) for source in sorted(folder.rglob("*.py"))]
    return hashlib.sha256("".join(digests).encode()).hexdigest()
