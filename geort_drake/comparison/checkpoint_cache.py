"""Trained retargeters kept for the next run, under a key made of everything that decides them."""

import dataclasses
import hashlib
import json
import warnings
from collections.abc import Mapping
from pathlib import Path

import geort_drake
from geort_drake.comparison.pipeline import DEFAULT_METHOD, train_checkpoint, training_config
from geort_drake.errors import CheckpointError
from geort_drake.files import digest_of
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.recording import Recording
from geort_drake.resources import cache_dir
from geort_drake.retargeting.checkpoint import load_checkpoint
from geort_drake.retargeting.retargeter import load_retargeter

_PACKAGE = Path(geort_drake.__file__).parent
# What the weights depend on besides data and settings: training, and the hand's samples and geometry.
TRAINING_CODE = (_PACKAGE / "retargeting", _PACKAGE / "hands")


def cached_checkpoint(
    hand_name: str,
    recording: Recording,
    method: str = DEFAULT_METHOD,
    seed: int = 0,
    device: str = "cpu",
    settings: Mapping | None = None,
) -> tuple[Path, bool]:
    """The checkpoint for a hand and a recording, trained now unless an equal one is at hand.

    The key covers the hand's model and description, the recording's contents, method, seed, device,
    all of the method's settings and the code of training and hands, so a change in any of them trains
    anew. A damaged checkpoint is trained again. What training warned of is warned of at every use.

    Args:
        hand_name, recording, method, seed, device, settings: as in `train_checkpoint`.

    Returns:
        The checkpoint's directory in `cache_dir() / "retargeters"`, and whether it was there already.

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
            said = load_checkpoint(path).provenance["warnings"]
        except CheckpointError:
            pass  # damaged: train it again
        else:
            for text in said:
                warnings.warn(text, RuntimeWarning, stacklevel=2)
            return path, True
    return train_checkpoint(hand_name, recording, path, method, seed, device, settings=settings), False
