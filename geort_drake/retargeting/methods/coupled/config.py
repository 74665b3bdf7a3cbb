"""Settings of `geort_coupled`."""

from dataclasses import dataclass

from geort_drake.errors import TrainingError
from geort_drake.retargeting.method import TrainingConfig

# Of fine-tuning, which starts from the map for everyone. A minute shows few pinches and collisions, so they
# weigh more; coverage weighs less, and the steps are small, because the map knows more than a minute shows.
FINE_TUNING_STEPS = 600
FINE_TUNING = {
    "learning_rate": 0.001,
    "averaging": 0.98,
    "pinch_weight": 1.5,
    "pinch_spread": 0.01,
    "collision_weight": 2.0,
    "coverage_weight": 0.8,
    "context_weight": 1.0,
}


@dataclass(frozen=True)
class CoupledConfig(TrainingConfig):
    """Settings of `train_coupled`. The weights are of ratios and need no unit."""

    steps: int = 8600
    learning_rate: float = 0.017  # of SOAP, falls to zero along half a cosine
    averaging: float = 0.998  # of the weights, in the second half
    hidden: int = 64
    residual_hidden: int = 112
    direction_weight: float = 3.15
    track_weight: float = 6.2
    coverage_weight: float = 1.59
    context_weight: float = 2.05
    cross_talk_weight: float = 5.6
    flatness_weight: float = 0.79
    response_weight: float = 0.97
    pinch_weight: float = 0.54
    false_pinch_weight: float = 2.2
    collision_weight: float = 0.68
    motion_target: float = 0.9723  # mean cosine, also along recorded steps
    cross_talk_target: float = 0.0352
    closed_target: float = 0.5  # fraction of pinches that close
    pinch_scale: float = 0.008  # m; where the loss of open pinches turns from square to linear
    pinch_spread: float = 0.005  # m; of the points at which made-up pinches meet
    pinch_offset_spread: float = 0.0  # m; of the offset between their tips; 0 keeps recorded directions
    mixed_pinch_fraction: float = 0.8  # of made-up pinches: other fingers are from another frame
    recorded_hand_fraction: float = 0.0  # of moved hands: recorded frames, as `even_fraction` draws them
    even_fraction: float = 0.0  # of recorded hands: postures are equally likely, however long they were held
    jitter: float = 0.004  # m; of the hands that must not collide
    collision_margin: float = 0.001  # m

    def validate(self) -> None:
        """Raises TrainingError for a value out of range."""
        super().validate()
        for name in ("motion_target", "closed_target"):
            if (value := getattr(self, name)) >= 1:
                raise TrainingError(f"training config: {name} must be below 1, it is {value}")
        if (limit := 1 - MIXED_HAND_FRACTION) < self.recorded_hand_fraction:
            raise TrainingError(
                f"training config: recorded_hand_fraction must be at most {limit:g}, it is "
                f"{self.recorded_hand_fraction:g}"
            )


MIXED_HAND_FRACTION = 0.4  # of moved hands: every other finger is from a frame of its own
