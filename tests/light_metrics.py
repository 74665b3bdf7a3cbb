"""An evaluation with few samples, for tests of what is around it."""

import functools

import pytest

from geort_drake.comparison import metrics


def lighten(patch: pytest.MonkeyPatch) -> None:
    """Makes the metrics quick, and their values mean little."""
    patch.setattr(metrics, "ROBOT_SAMPLES", 500)
    for name in ("motion_preservation", "cross_talk", "flatness_and_gain"):
        patch.setattr(metrics, name, functools.partial(getattr(metrics, name), anchors=30))
    patch.setattr(metrics, "context_averaged", functools.partial(metrics.context_averaged, contexts=2))
    patch.setattr(metrics, "call_times", functools.partial(metrics.call_times, calls=10))
