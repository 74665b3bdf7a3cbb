"""Settings of the training of `geort_coupled` and of the universal map."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geort_drake.retargeting.method import TrainingConfig


@dataclass(frozen=True)
class CoupledConfig(TrainingConfig):
    """Length of a training, and the bounds of its constraints.

    Coverage is maximised as far as the bounds allow. The bounds apply to averages over training hands, many
    of which are harder than recorded ones.
    """

    steps: int = 6000
    learning_rate: float = 0.005  # of SOAP; falls to zero along half a cosine
    direction: float = 0.038  # 1 − mean cosine between motions of human and robot fingertips
    track: float = 0.035  # the same for recorded steps
    cross_talk: float = 0.038  # mean motion of the other fingertips over that of the moved one
    curvature: float = 0.12  # mean squared second over first differences
    uneven: float = 0.10  # fraction of motions whose gain is far from the person's median
    open_pinch: float = 0.012  # fraction of pinches in which the robot's fingertips do not touch
    deep_pinch: float = 0.01  # fraction of pinches in which they overlap by most of their diameter
    false_pinch: float = 0.0012  # fraction of pairs that touch although the person's are apart
    collision: float = 0.0012  # fraction of hands in which links overlap by 2 mm


# Settings of the universal map. Its first three bounds apply to the worse half of the people.
UNIVERSAL_CONFIG = CoupledConfig(
    steps=30_000, learning_rate=0.003, direction=0.044, track=0.042, cross_talk=0.044
)


def refit_steps(seconds: float) -> int:
    """Returns the steps of a refit to one person: 400 for each minute of play, from 600 to 2,000."""
    return round(400 * min(max(seconds / 60, 1.5), 5.0))


@dataclass(frozen=True)
class Start:
    """The start of a training of one person's map.

    Attributes:
        arrays: weights of a `CoupledRetargeter`.
        p_HF: (M, T, F, 3) fingertips, m, of M likely plays of the person. They complement the training hands,
            because a short recording covers little of the space that the person will visit.
    """

    arrays: Mapping[str, np.ndarray]
    p_HF: np.ndarray


CONSTRAINTS = tuple(
    name for name in CoupledConfig.__dataclass_fields__ if name not in TrainingConfig.__dataclass_fields__
)
