"""Settings of `geort`."""

from collections.abc import Mapping
from dataclasses import dataclass

from geort_drake.errors import UnknownNameError
from geort_drake.retargeting.method import TrainingConfig, check_numbers

FORWARD_KINEMATICS = ("exact", "neural")
RESAMPLING = ("frames", "independent")


@dataclass(frozen=True)
class GeortConfig(TrainingConfig):
    """Settings of `train_geort`. Weights refer to lengths measured in `length_unit`."""

    hidden: int = 128  # width of both hidden layers of each finger's network
    points: int = 256  # human fingertips per finger and step, criteria I to III
    targets: int = 512  # robot fingertips per finger and step, criterion II
    pinches: int = 96  # real frames with a pinch per step, criterion IV
    frames: int = 128  # real frames per step, criterion V
    length_unit: float = 0.1  # m; unit of length of the weights below
    coverage_weight: float = 7.0  # λ1, 1/unit²
    flatness_weight: float = 3.0  # λ2, 1/unit²
    pinch_weight: float = 2.0  # λ3, 1/unit²
    collision_weight: float = 0.25  # λ4
    other_pinches: float = 0.2  # weight of a pinching pair that is not the frame's nearest
    fk: str = "exact"  # forward kinematics in training
    resampling: str = "frames"  # hands in criteria IV and V: recorded, or with independently drawn fingers
    classifier_steps: int = 2000  # gradient steps of the collision classifier
    kinematics_steps: int = 4000  # gradient steps of the neural forward kinematics
    refreshes: int = 10  # number of refits of the classifier to the retargeter's own outputs

    def validate(self) -> None:
        """Raises TrainingError for a number out of range, UnknownNameError for an unknown choice."""
        check_numbers(self, may_be_zero=("refreshes", "other_pinches"))
        for name, choices in (("fk", FORWARD_KINEMATICS), ("resampling", RESAMPLING)):
            if getattr(self, name) not in choices:
                raise UnknownNameError(name, getattr(self, name), choices)


# Choices of the authors' public code that differ from their paper, as far as these settings can express them;
# docs/results/open-loop.md lists the differences and their cost.
PUBLIC_CHOICES: Mapping[str, int | float | str] = {
    "resampling": "independent",
    "fk": "neural",
    "length_unit": 1.0,
    "coverage_weight": 80.0,
    "flatness_weight": 0.1,
    "pinch_weight": 1.0,
    "collision_weight": 0.0,
    "other_pinches": 1.0,
    "steps": 1250,  # 50 epochs of 25 batches
    "points": 2048,
    "targets": 2048,
    "pinches": 2048,
    "refreshes": 0,
}
PRESETS: Mapping[str, Mapping[str, int | float | str]] = {"public": PUBLIC_CHOICES}
