"""Trainings of a few steps, for tests of what is around them."""

import os
from pathlib import Path

from geort_drake import Hand, Recording, train_map

_TINY = {"steps": 5, "hidden": 8}
LIGHT = {
    "geort": _TINY | {"points": 32, "gestures": 16, "robot_samples": 1000, "pretraining_steps": 5},
    "telekinesis": _TINY,
}


def train_lightly(
    hand: str | os.PathLike | Hand,
    recording: Recording,
    output: Path,
    method: str = "telekinesis",
    seed: int = 0,
    **settings,
) -> Path:
    """Writes a map after a training of a few steps."""
    hand = hand if isinstance(hand, Hand) else Hand(hand)
    settings = LIGHT[method] | settings
    train_map(hand, recording, method, seed, settings=settings, show_progress=False).save(output)
    return output
