"""The interface of retargeting methods: settings, training data and results.

`geort_drake.retargeting.methods` lists the methods.
"""

import dataclasses
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from geort_drake.errors import TrainingError

if TYPE_CHECKING:
    from geort_drake.retargeting.numpy_retargeter import Retargeter
    from geort_drake.retargeting.training.collision_geometry import CollisionShapes
    from geort_drake.retargeting.training.kinematics import HandKinematics
    from geort_drake.retargeting.training.networks import RetargetingNetwork

# Maps human points (F, 3), (N, F, 3), (21, 3) or (N, 21, 3), m, to joint angles (n,) or (N, n), rad.
Retarget = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class TrainingConfig:
    """Settings common to all trained methods; each method adds its own in a subclass."""

    steps: int = 5000  # gradient steps
    learning_rate: float = 5e-3  # of the first step; falls to zero along half a cosine

    def validate(self) -> None:
        """Raises TrainingError for a number out of range."""
        check_numbers(self)


def check_numbers(config: TrainingConfig, may_be_zero: Collection[str] = ()) -> None:
    """Checks that numeric settings are finite and positive.

    Settings named `*_weight` or `*_spread`, and those in `may_be_zero`, may be zero; those named `*_fraction`
    must be from 0 to 1.

    Raises:
        TrainingError: a number is out of range, or a text stands in its place.
    """
    for name, value in dataclasses.asdict(config).items():
        if isinstance(getattr(type(config), name), str):
            continue
        if isinstance(value, str):
            raise TrainingError(f"training config: {name} must be a number, it is '{value}'")
        fraction = name.endswith("_fraction")
        zero = fraction or name.endswith(("_weight", "_spread")) or name in may_be_zero
        if not math.isfinite(value) or value < 0 or (value == 0 and not zero):
            expected = "zero or positive" if zero else "positive"
            raise TrainingError(f"training config: {name} must be {expected}, it is {value}")
        if fraction and value > 1:
            raise TrainingError(f"training config: {name} must be from 0 to 1, it is {value}")


@dataclass(frozen=True)
class TrainingData:
    """Data for training. Expensive parts are functions, which a method calls if it needs them.

    Attributes:
        p_HF: (T, F, 3) human fingertips in H, m, in successive frames; fingers as in `kinematics`.
        kinematics: exact kinematics of the robot hand.
        q: (N, n) robot joint angles, rad, uniform within the limits.
        labels: returns (N,) whether the hand collides at each row of q, ignoring contacts between
            fingertips.
        collides: does the same for any joint angles (M, n), rad.
        shapes: returns the hand's collision geometry.
    """

    p_HF: np.ndarray
    kinematics: "HandKinematics"
    q: np.ndarray
    labels: Callable[[], np.ndarray] | None = None
    collides: Callable[[np.ndarray], np.ndarray] | None = None
    shapes: Callable[[], "CollisionShapes"] | None = None

    def check_q(self) -> None:
        """Raises TrainingError unless q has the hand's joints, is finite and has at least 1000 rows."""
        expected = (len(self.q), len(self.kinematics.joint_names))
        if np.shape(self.q) != expected or not np.isfinite(self.q).all():
            raise TrainingError(
                f"robot samples: q must be finite and of shape {expected}; it has shape {np.shape(self.q)}"
            )
        if len(self.q) < 1000:
            raise TrainingError(f"robot samples: at least 1000 are needed, {len(self.q)} were given")


@dataclass
class TrainingResult:
    """A trained network and figures of its training."""

    network: "RetargetingNetwork"
    history: list[dict[str, float]]
    timings: dict[str, float] = field(default_factory=dict)  # wall time, s
    stopped_at: int | None = None  # the step at which the loss stopped being finite
    human_points: dict[str, int] = field(default_factory=dict)  # number per finger, after thinning
    pinch_frames: int = 0
    classifier: dict[str, float] = field(default_factory=dict)  # held-out figures
    neural_kinematics: dict[str, float] = field(default_factory=dict)  # held-out errors; empty if exact


@dataclass(frozen=True)
class TrainedMethod:
    """A method that learns a map, which is stored in a checkpoint.

    Attributes:
        name: name in commands and in a checkpoint's config.json.
        summary: one line for --help.
        config: type of the settings.
        train: called as train(data, config=None, seed=0, device="cpu", report=None); returns a
            `TrainingResult`. The seed determines the initial weights and all draws; the device is "cpu" or
            "cuda"; for `report` see `Report`. Raises TrainingError for unusable input or a loss that is not
            finite at the first step; for later divergence see `descend`.
        retargeter: makes the map from the arrays of a checkpoint; takes the arguments of `Retargeter`.
    """

    name: str
    summary: str
    config: type[TrainingConfig]
    train: Callable[..., TrainingResult]
    retargeter: "Callable[..., Retargeter]"


@dataclass(frozen=True)
class ShippedMethod:
    """A universal map that is shipped for a robot hand; `shipped_map` finds it.

    Attributes:
        name, summary: as in `TrainedMethod`.
    """

    name: str
    summary: str


@dataclass(frozen=True)
class UntrainedMethod:
    """A method that needs no training.

    Attributes:
        name, summary: as in `TrainedMethod`.
        make: called as make(kinematics, human_keypoints, frames, seed); returns the map. See
            `methods.make_untrained`.
    """

    name: str
    summary: str
    make: Callable[..., Retarget]
