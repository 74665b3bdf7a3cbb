"""GeoRT's training loop (Yin et al. 2025, Algorithm 1) with all five criteria.

Randomness comes from the seed alone and the CPU's work is done by one thread, so two runs on one
machine give the same weights.
"""

import dataclasses
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from geort_drake.errors import TrainingError, UnknownNameError
from geort_drake.retargeting.clouds import voxel_thinned
from geort_drake.retargeting.training import criteria
from geort_drake.retargeting.training.descent import Report, descend, device_of, one_thread
from geort_drake.retargeting.training.human_data import HumanData
from geort_drake.retargeting.training.kinematics import HandKinematics
from geort_drake.retargeting.training.networks import RetargetingNetwork
from geort_drake.retargeting.training.pretraining import (
    RobotSamples,
    check_robot_samples,
    fit_classifier,
    fit_neural_kinematics,
    refit_classifier,
)

FORWARD_KINEMATICS = ("exact", "neural")
RESAMPLING = ("frames", "independent")
_CHOICES = {"fk": ("forward kinematics", FORWARD_KINEMATICS), "resampling": ("resampling", RESAMPLING)}
_MAY_BE_ZERO = ("refreshes", "other_pinches", "pinch_offset_spread")  # besides weights and shares


@dataclass(frozen=True)
class TrainingConfig:
    """Settings of `train_geort`. Weights refer to lengths measured in `length_unit`."""

    steps: int = 5000  # descent steps
    points: int = 256  # human fingertips per finger and step, criteria I to III
    targets: int = 512  # robot fingertips per finger and step, criterion II
    pinches: int = 96  # real frames with a pinch per step, criterion IV
    frames: int = 128  # real frames per step, criterion V
    learning_rate: float = 5e-3  # of Adam, falls to zero along half a cosine
    hidden: int = 128  # width of both hidden layers
    length_unit: float = 0.1  # m; the unit in which the weights below are meant
    coverage_weight: float = 7.0  # λ1, 1/unit²
    flatness_weight: float = 3.0  # λ2, 1/unit²
    pinch_weight: float = 2.0  # λ3, 1/unit²
    collision_weight: float = 0.25  # λ4
    step_sigma: float = 0.004  # m; d ~ N(0, σ²) per coordinate, criteria I and III
    pinch_threshold: float = 0.015  # m; nearer human fingertips pinch
    other_pinches: float = 0.2  # weight of a pinching pair that is not the frame's nearest
    human_voxel: float = 0.001  # m; thinning of the human clouds
    robot_voxel: float = 0.003  # m; thinning of the robot's clouds
    fk: str = "exact"  # exact | neural
    resampling: str = "frames"  # frames | independent: hands of criteria IV, V are recorded or put together
    classifier_steps: int = 2000  # descent steps of the collision classifier
    kinematics_steps: int = 4000  # descent steps of the neural forward kinematics
    refreshes: int = 10  # how often the classifier learns from the retargeter's own outputs
    refresh_steps: int = 200  # descent steps of each refresh
    refresh_samples: int = 3000  # real frames whose outputs are labelled at each refresh
    refresh_sigma: float = 0.08  # rad; spread of the samples around the retargeter's outputs

    def validate(self) -> None:
        """Raises TrainingError where a value makes no sense, UnknownNameError where a name is none."""
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            if item.name in _CHOICES:
                kind, choices = _CHOICES[item.name]
                if value not in choices:
                    raise UnknownNameError(kind, value, choices)
                continue
            if item.name.endswith("_share"):
                if not 0 <= value <= 1:
                    raise TrainingError(f"training config: {item.name} must be from 0 to 1, it is {value}")
                continue
            may_be_zero = item.name.endswith("_weight") or item.name in _MAY_BE_ZERO
            if not math.isfinite(value) or value < 0 or (value == 0 and not may_be_zero):
                wanted = "zero or positive" if may_be_zero else "positive"
                raise TrainingError(f"training config: {item.name} must be {wanted}, it is {value}")


# What the authors' public code does otherwise than their paper, as far as the terms here can express it;
# docs/results/open-loop.md lists the differences and what they cost.
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


@dataclass
class TrainingResult:
    """What a trainer learned, and how it went."""

    network: RetargetingNetwork
    history: list[dict[str, float]]
    classifier: dict[str, float] = field(default_factory=dict)  # held-out figures
    neural_kinematics: dict[str, float] = field(default_factory=dict)  # held-out errors, empty if exact
    timings: dict[str, float] = field(default_factory=dict)  # wall seconds
    stopped_at: int | None = None  # the step at which the loss stopped being finite
    human_points: dict[str, int] = field(default_factory=dict)  # per finger, after thinning
    pinch_frames: int = 0


# How every method is trained: with the arguments of `train_geort` up to `report`, and perhaps others.
Trainer = Callable[..., TrainingResult]


def train_geort(
    p_HF: np.ndarray,
    kinematics: HandKinematics,
    robot_samples: RobotSamples,
    config: TrainingConfig | None = None,
    seed: int = 0,
    device: str = "cpu",
    report: Report | None = None,
    collides_beyond_tips: Callable[[np.ndarray], np.ndarray] | None = None,
) -> TrainingResult:
    """Trains independent per-finger retargeting networks without paired data.

    Args:
        p_HF: (T, F, 3) human fingertips in H, m; a row is one instant, fingers as in `kinematics`.
        kinematics: exact kinematics of the robot hand.
        robot_samples: uniform samples of the robot's joint angles, with labels.
        config: settings; the defaults are meant for all recordings.
        seed: fixes the initial weights and every draw.
        device: "cpu" or "cuda".
        report: see `Report`.
        collides_beyond_tips: labels joint angles (N, n) as colliding (N,). With it the classifier
            also learns from the retargeter's own outputs, from time to time; it is frozen otherwise.

    Raises:
        TrainingError: on unusable input, or when the loss is not finite from the start. When it
            stops being finite later, the last good weights are returned with a RuntimeWarning.
            A finger that never pinches is named in a RuntimeWarning.
    """
    config = config or TrainingConfig()
    config.validate()
    check_robot_samples(robot_samples, kinematics, labels=True)
    with one_thread():
        run = _Run(p_HF, kinematics, robot_samples, config, seed, device_of(device), collides_beyond_tips)
        return run.train(report)


class _Run:
    """The state of one training run."""

    def __init__(
        self,
        p_HF: np.ndarray,
        kinematics: HandKinematics,
        samples: RobotSamples,
        config: TrainingConfig,
        seed: int,
        device: torch.device,
        oracle: Callable[[np.ndarray], np.ndarray] | None,
    ):
        self.config, self.kinematics, self.device, self.oracle = config, kinematics, device, oracle
        self.unit = config.length_unit
        # One stream for all draws, on the CPU so that it does not depend on the device.
        self.generator = torch.Generator().manual_seed(seed)
        self.timings: dict[str, float] = {}
        self._load_human(p_HF)
        self._load_robot(samples)

        started = time.perf_counter()
        self.classifier, self.classifier_figures = fit_classifier(
            kinematics, samples, self.generator, device, config.classifier_steps
        )
        self.timings["classifier_s"] = time.perf_counter() - started
        self.kinematics_figures: dict[str, float] = {}
        self.fingertips = kinematics.fingertips
        if config.fk == "neural":
            started = time.perf_counter()
            neural, self.kinematics_figures = fit_neural_kinematics(
                kinematics, samples, self.generator, device, config.kinematics_steps
            )
            self.fingertips = neural.fingertips
            self.timings["neural_kinematics_s"] = time.perf_counter() - started
        self.network = RetargetingNetwork(
            kinematics, self.mean, self.scale, config.hidden, self.generator
        ).to(device)

    def train(self, report: Report | None) -> TrainingResult:
        config = self.config
        refreshes = {round(config.steps * (k + 1) / (config.refreshes + 1)) for k in range(config.refreshes)}

        def losses(step: int) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
            if self.oracle is not None and step in refreshes:
                self._refresh_classifier()
            return self._losses()

        descent = descend(self.network, losses, config.steps, config.learning_rate, report)
        return TrainingResult(
            network=self.network.cpu(),
            history=descent.history,
            classifier=self.classifier_figures,
            neural_kinematics=self.kinematics_figures,
            timings={**self.timings, "training_s": descent.seconds},
            stopped_at=descent.stopped_at,
            human_points=self.human_points,
            pinch_frames=len(self.pinch_rows),
        )

    def _losses(self) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """The weighted sum of the five criteria on one random batch, and each of them."""
        config, unit = self.config, self.unit
        # Criteria I to III: points drawn uniformly from each finger's cloud, and steps around them.
        x = self._draw(self.human_clouds, config.points)
        d = config.step_sigma * torch.randn(x.shape, generator=self.generator).to(self.device)
        pinching, pinch_weights = self._pinches()
        hands = self._hands(config.frames)
        # One pass through the networks for everything is faster than one per criterion.
        n, k = config.points, len(pinching)
        q = self.network(torch.cat([x, x + d, x - d, pinching, hands]))
        p_BF = self.fingertips(q[: 3 * n + k]) / unit
        here, ahead, behind = p_BF[:n], p_BF[n : 2 * n], p_BF[2 * n : 3 * n]
        targets = self._draw(self.robot_clouds, config.targets) / unit
        row = {
            "direction": criteria.direction_loss(d / unit, ahead - here),
            "coverage": criteria.chamfer_loss(targets.transpose(0, 1), here.transpose(0, 1)),
            "flatness": criteria.flatness_loss(ahead, here, behind),
            "pinch": criteria.pinch_loss(p_BF[3 * n :], self.pairs, pinch_weights),
            "collision": criteria.collision_loss(self.classifier(q[3 * n :])),
        }
        total = (
            row["direction"]
            + config.coverage_weight * row["coverage"]
            + config.flatness_weight * row["flatness"]
            + config.pinch_weight * row["pinch"]
            + config.collision_weight * row["collision"]
        )
        return total, row

    def _pinches(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Hands (N, F, 3) for criterion IV and the weights (N, P) of their pairs."""
        config = self.config
        if config.resampling == "independent":
            hands = self._hands(config.pinches)
            return hands, self._pinch_weights_of(hands)
        rows = self._rows(self.pinch_rows, config.pinches)
        return self.frames[rows], self.pinch_weights[rows]

    def _hands(self, count: int) -> torch.Tensor:
        """Hands (N, F, 3): recorded ones, or such that no person made, each finger from its own cloud."""
        if self.config.resampling == "independent":
            return self._draw(self.human_clouds, count)
        return self.frames[self._rows(self.all_rows, count)]

    def _pinch_weights_of(self, hands: torch.Tensor) -> torch.Tensor:
        config = self.config
        return criteria.pinch_weights(hands, self.pairs, config.pinch_threshold, config.other_pinches)

    def _load_human(self, p_HF: np.ndarray) -> None:
        human = HumanData(p_HF, self.kinematics.finger_names, self.config.human_voxel)
        self.human_points = human.points
        self.human_clouds = [self._tensor(cloud) for cloud in human.clouds]
        self.mean, self.scale = torch.tensor(human.mean), torch.tensor(human.scale)
        self.frames = self._tensor(human.frames)
        self.all_rows = torch.arange(len(human.frames))
        self.pairs = human.pairs
        self.pinch_weights = self._pinch_weights_of(self.frames)
        self.pinch_rows = torch.nonzero(self.pinch_weights.sum(1).cpu() > 0)[:, 0]
        if self.config.pinch_weight > 0:
            human.check_pinches(self.config.pinch_threshold)

    def _load_robot(self, samples: RobotSamples) -> None:
        q = torch.tensor(np.asarray(samples.q), dtype=torch.float64)
        p_BF = self.kinematics.fingertips(q).numpy()
        self.robot_clouds = [
            self._tensor(voxel_thinned(p_BF[:, i], self.config.robot_voxel)) for i in range(p_BF.shape[1])
        ]
        self.uniform = (
            self._tensor(np.asarray(samples.q)),
            self._tensor(np.asarray(samples.collides_beyond_tips, dtype=float)),
        )
        # Joint angles that the retargeter put out, with their labels.
        self.own = (self.uniform[0][:0], self.uniform[1][:0])

    def _refresh_classifier(self) -> None:
        """Labels what the retargeter puts out now, and its surroundings, and learns from it too."""
        assert self.oracle is not None  # or there are no refreshes
        started = time.perf_counter()
        with torch.no_grad():
            q = self.network(self._hands(self.config.refresh_samples))
            if not torch.isfinite(q).all():
                return  # the check of the loss, which comes next, stops the run
            noise = torch.randn(q.shape, generator=self.generator).to(self.device)
            near = q + self.config.refresh_sigma * noise
            lower, upper = self._tensor(self.kinematics.lower), self._tensor(self.kinematics.upper)
            q = torch.cat([q, torch.clamp(near, lower, upper)])
        label = np.asarray(self.oracle(q.cpu().numpy().astype(float)), dtype=float)
        # What was labelled earlier stays in, so that the map cannot slip back unnoticed.
        self.own = (torch.cat([self.own[0], q]), torch.cat([self.own[1], self._tensor(label)]))
        refit_classifier(self.classifier, self.uniform, self.own, self.generator, self.config.refresh_steps)
        self.timings["refresh_s"] = self.timings.get("refresh_s", 0.0) + time.perf_counter() - started

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.tensor(array, dtype=torch.float32, device=self.device)

    def _rows(self, rows: torch.Tensor, count: int) -> torch.Tensor:
        if len(rows) == 0:
            return rows
        return rows[torch.randint(len(rows), (count,), generator=self.generator)]

    def _draw(self, clouds: Sequence[torch.Tensor], count: int) -> torch.Tensor:
        """(count, F, 3) points, drawn from each finger's cloud independently."""
        return torch.stack(
            [cloud[torch.randint(len(cloud), (count,), generator=self.generator)] for cloud in clouds], dim=1
        )
