"""Settings of the training of a map for everyone."""

import dataclasses
import math
from dataclasses import dataclass

from geort_drake.errors import TrainingError


@dataclass(frozen=True)
class UniversalConfig:
    """Size of the training, and the bounds of its constraints.

    Coverage is maximised as far as the bounds allow. They hold on average over training hands, many of which
    are harder than recorded ones: those of direction, track and cross-talk over the half of the people for
    whom the figure is worse, the others over all people.
    """

    people: int = 800
    steps: int = 30_000
    learning_rate: float = 0.003  # of SOAP; falls to zero along half a cosine
    direction: float = 0.044  # 1 − mean cosine between motions of a human fingertip and the robot's
    track: float = 0.042  # the same along recorded steps
    cross_talk: float = 0.044  # mean motion of other fingertips over the moved one's
    curvature: float = 0.12  # mean squared second over first differences
    uneven: float = 0.10  # fraction of motions whose gain is far from the finger's median
    open_pinch: float = 0.012  # fraction of pinches in which the robot's fingertips do not touch
    deep_pinch: float = 0.01  # fraction in which they overlap by most of their radius
    false_pinch: float = 0.0012  # fraction of pairs that touch although the person's are apart
    collision: float = 0.0012  # fraction of hands in which links overlap by 2 mm

    def validate(self) -> None:
        """Raises TrainingError for a value out of range."""
        for name, value in dataclasses.asdict(self).items():
            whole = name in ("people", "steps")
            if not math.isfinite(value) or value <= 0 or (whole and value != int(value)):
                expected = "a positive whole number" if whole else "positive"
                raise TrainingError(f"training config: {name} must be {expected}, it is {value}")


CONSTRAINTS = tuple(
    name for name in UniversalConfig.__dataclass_fields__ if name not in ("people", "steps", "learning_rate")
)
