"""Short trainings and evaluations with few samples, for tests of what is around them."""

import functools
from pathlib import Path

import pytest

from geort_drake import Recording, train_checkpoint
from geort_drake.comparison import metrics

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


def lighten(patch: pytest.MonkeyPatch) -> None:
    """Makes the metrics quick, and their values mean little."""
    patch.setattr(metrics, "ROBOT_SAMPLES", 500)
    for name in ("motion_preservation", "cross_talk", "flatness_and_gain"):
        patch.setattr(metrics, name, functools.partial(getattr(metrics, name), anchors=30))
    patch.setattr(metrics, "context_averaged", functools.partial(metrics.context_averaged, contexts=2))
    patch.setattr(metrics, "call_times", functools.partial(metrics.call_times, calls=10))


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
