"""GeoRT as in the paper (Yin et al. 2025, Algorithm 1): one network per finger, five criteria."""

from typing import TYPE_CHECKING

from geort_drake.retargeting.method import TrainedMethod, TrainingData, TrainingResult
from geort_drake.retargeting.methods.geort.config import PRESETS, GeortConfig
from geort_drake.retargeting.numpy_retargeter import Retargeter

if TYPE_CHECKING:
    from geort_drake.retargeting.training.descent import Report

__all__ = ["METHODS", "PRESETS", "GeortConfig", "train_geort"]


def train_geort(
    data: TrainingData,
    config: GeortConfig | None = None,
    seed: int = 0,
    device: str = "cpu",
    report: "Report | None" = None,
) -> TrainingResult:
    """Trains one network per finger; see `TrainedMethod.train`.

    The data must have `labels`. With `collides`, the collision classifier is refitted at intervals to the
    retargeter's own outputs; without it, the classifier stays frozen. A RuntimeWarning names fingers that
    never pinch.
    """
    from geort_drake.retargeting.methods.geort.training import train

    return train(data, config or GeortConfig(), seed, device, report)


METHODS = (
    TrainedMethod(
        "geort",
        "GeoRT's five criteria with our weights: one network per finger",
        GeortConfig,
        train_geort,
        Retargeter,
    ),
)
