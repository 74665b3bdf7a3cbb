"""Trainings of a few steps, for tests of what is around them."""

from pathlib import Path

from geort_drake import Recording, train_checkpoint

LIGHT = {
    "geort": {
        "hidden": 8,
        "points": 16,
        "targets": 32,
        "pinches": 8,
        "frames": 8,
        "classifier_steps": 5,
        "refreshes": 0,
    },
    "linear_offline": {"hidden": 8},
}


def train_lightly(
    hand: str | Path,
    recording: Recording,
    output: Path,
    method: str = "linear_offline",
    seed: int = 0,
    **settings,
) -> Path:
    """A checkpoint of a training of a few steps."""
    settings = {"steps": 5} | LIGHT.get(method, {}) | settings
    options = {"show_progress": False, "settings": settings, "robot_samples": 1000}
    return train_checkpoint(hand, recording, output, method, seed, **options)
