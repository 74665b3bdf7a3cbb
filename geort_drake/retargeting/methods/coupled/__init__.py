"""`geort_coupled` (a network per finger and a residual that sees all fingertips) and the universal map.

Import from this module only; its submodules may change. docs/concepts/derivations.md derives the losses.
"""

from typing import TYPE_CHECKING

from geort_drake.retargeting.method import ShippedMethod, TrainedMethod, TrainingData, TrainingResult
from geort_drake.retargeting.methods.coupled.config import UNIVERSAL_CONFIG, CoupledConfig, Start, refit_steps
from geort_drake.retargeting.methods.coupled.retargeter import CoupledRetargeter

if TYPE_CHECKING:
    from geort_drake.retargeting.training.descent import Report

__all__ = [
    "METHODS",
    "UNIVERSAL_CONFIG",
    "CoupledConfig",
    "CoupledRetargeter",
    "Start",
    "refit_steps",
    "train_coupled",
]


def train_coupled(
    data: TrainingData,
    config: CoupledConfig | None = None,
    seed: int = 0,
    device: str = "cpu",
    report: "Report | None" = None,
    start: Start | None = None,
) -> TrainingResult:
    """Trains a map in which each joint depends on all fingertips; see `TrainedMethod.train`.

    Collisions are avoided if `data` has `shapes`. A RuntimeWarning names fingers that never pinch.

    Args:
        data, config, seed, device, report: see `TrainedMethod.train`.
        start: weights to start from and plays to add; None starts from random weights.
    """
    from geort_drake.retargeting.methods.coupled.training import train

    return train(data, config or CoupledConfig(), seed, device, report, start)


METHODS = (
    TrainedMethod(
        "geort_coupled",
        "all five criteria, by a network that sees all fingertips",
        CoupledConfig,
        train_coupled,
        CoupledRetargeter,
    ),
    ShippedMethod("universal", "one map for every person, shipped for the hand"),
)
