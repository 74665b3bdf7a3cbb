"""Fits the universal map to one person, from a recording to an evaluated checkpoint."""

import os
from pathlib import Path

from geort_drake.comparison.train import train_checkpoint, training_recording
from geort_drake.errors import CheckpointError
from geort_drake.files import sha256_of
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.recording import Recording
from geort_drake.retargeting.map_file import shipped_maps
from geort_drake.retargeting.methods.coupled import Start, refit_steps
from geort_drake.retargeting.methods.coupled.population import likely_plays
from geort_drake.retargeting.retargeter import load_retargeter
from geort_drake.retargeting.universal import UniversalRetargeter


def refit_checkpoint(
    recording: Recording | str | os.PathLike,
    output: str | os.PathLike,
    hand_name: str | os.PathLike = "allegro_right",
    map_file: str | os.PathLike | None = None,
    steps: int | None = None,
    seed: int = 0,
    show_progress: bool = True,
) -> Path:
    """Fits the universal map to one person and writes a checkpoint of `geort_coupled`.

    The person's code is folded into the weights, which are then trained further on the recording.

    Args:
        recording: one to five minutes of the person's hand, or its file.
        output: path of the checkpoint directory.
        hand_name: name or file of the robot hand's description.
        map_file: file of the universal map; by default the one that is shipped for the hand.
        steps: number of training steps; by default that of `refit_steps`.
        seed: seed of the training and the metrics.
        show_progress: draw progress bars on stderr.

    Returns:
        The checkpoint directory.

    Raises:
        CheckpointError: the map is damaged or for another hand, or there is none for the hand; or `output`
            exists and is not a checkpoint.
        HandError, RecordingError, TrainingError: the hand or the recording is unsuitable.
    """
    description = load_hand(hand_name)
    path = shipped_maps().get(description.name) if map_file is None else Path(map_file)
    if path is None:
        raise CheckpointError(
            f"no universal map is shipped for {description.name}; make one with geort-drake pretrain"
        )
    universal = load_retargeter(path, HandModel(description))
    if not isinstance(universal, UniversalRetargeter):
        raise CheckpointError(f"{path}: a universal map is needed, this is a checkpoint of one person")
    recording = training_recording(recording, description.side)
    p_HK = recording.p_HK[recording.valid].astype(float)
    arrays = universal.folded_arrays(universal.code(p_HK))
    return train_checkpoint(
        hand_name,
        recording,
        output,
        seed=seed,
        show_progress=show_progress,
        settings={"steps": steps or refit_steps(len(p_HK) / recording.rate_hz)},
        start=Start(arrays, likely_plays(p_HK, universal.finger_names, seed)),
        provenance={"map": {"name": path.name, "sha256": sha256_of(path)}},
    )
