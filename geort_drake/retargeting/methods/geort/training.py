"""Trains `geort`; equal seeds give equal weights on the same machine."""

import time
from collections.abc import Sequence

import numpy as np
import torch

from geort_drake.errors import TrainingError
from geort_drake.people.recording import PINCH_M
from geort_drake.retargeting.clouds import voxel_thinned
from geort_drake.retargeting.method import TrainingData, TrainingResult
from geort_drake.retargeting.methods.geort.config import GeortConfig
from geort_drake.retargeting.training import criteria
from geort_drake.retargeting.training.descent import Report, descend, device_of, one_thread
from geort_drake.retargeting.training.human_data import HumanData
from geort_drake.retargeting.training.networks import RetargetingNetwork
from geort_drake.retargeting.training.pretraining import (
    fit_classifier,
    fit_neural_kinematics,
    refit_classifier,
)

STEP_SIGMA = 0.004  # m; d ~ N(0, σ²) per coordinate in criteria I and III
ROBOT_VOXEL = 0.003  # m; thins the robot's clouds
REFRESH_STEPS = 200  # gradient steps of the classifier at each refresh
REFRESH_SAMPLES = 3000  # real frames whose outputs are labelled at each refresh
REFRESH_SIGMA = 0.08  # rad; spread of the samples around the retargeter's outputs


def train(
    data: TrainingData, config: GeortConfig, seed: int, device: str, report: Report | None
) -> TrainingResult:
    """See `train_geort`."""
    config.validate()
    data.check_q()
    if data.labels is None:
        raise TrainingError(
            "geort learns from collisions of the robot samples; the training data has no labels"
        )
    with one_thread():
        return _Training(data, data.labels(), config, seed, device_of(device)).run(report)


class _Training:
    """The state of a training."""

    def __init__(
        self, data: TrainingData, labels: np.ndarray, config: GeortConfig, seed: int, device: torch.device
    ):
        kinematics = data.kinematics
        self.config, self.kinematics, self.device = config, kinematics, device
        self.collides = data.collides
        self.unit = config.length_unit
        # One generator for all draws, on the CPU so that they do not depend on the device.
        self.generator = torch.Generator().manual_seed(seed)
        self.timings: dict[str, float] = {}
        human = HumanData(data.p_HF, kinematics.finger_names)
        self.human_points = human.points
        self.human_clouds = [self._tensor(cloud) for cloud in human.clouds]
        self.frames = self._tensor(human.frames)
        self.all_rows = torch.arange(len(human.frames))
        self.pairs = human.pairs
        self.pinch_weights = self._pinch_weights_of(self.frames)
        self.pinch_rows = torch.nonzero(self.pinch_weights.sum(1).cpu() > 0)[:, 0]
        if config.pinch_weight > 0:
            human.check_pinches()
        p_BF = kinematics.fingertips(torch.tensor(data.q, dtype=torch.float64)).numpy()
        self.robot_clouds = [
            self._tensor(voxel_thinned(p_BF[:, i], ROBOT_VOXEL)) for i in range(p_BF.shape[1])
        ]
        self.uniform = (self._tensor(data.q), self._tensor(np.asarray(labels, dtype=float)))
        # Joint angles that the retargeter returned, with their labels.
        self.own = (self.uniform[0][:0], self.uniform[1][:0])

        started = time.perf_counter()
        self.classifier, self.classifier_figures = fit_classifier(
            kinematics, data.q, labels, self.generator, device, config.classifier_steps
        )
        self.timings["classifier_s"] = time.perf_counter() - started
        self.kinematics_figures: dict[str, float] = {}
        self.fingertips = kinematics.fingertips
        if config.fk == "neural":
            started = time.perf_counter()
            neural, self.kinematics_figures = fit_neural_kinematics(
                kinematics, data.q, self.generator, device, config.kinematics_steps
            )
            self.fingertips = neural.fingertips
            self.timings["neural_kinematics_s"] = time.perf_counter() - started
        mean, scale = torch.tensor(human.mean), torch.tensor(human.scale)
        self.network = RetargetingNetwork(kinematics, mean, scale, config.hidden, self.generator).to(device)

    def run(self, report: Report | None) -> TrainingResult:
        config = self.config
        refreshes = {round(config.steps * (k + 1) / (config.refreshes + 1)) for k in range(config.refreshes)}

        def losses(step: int) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
            if self.collides is not None and step in refreshes:
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
        """Computes the weighted sum of the five criteria on a random batch, and each of them."""
        config, unit = self.config, self.unit
        # Criteria I to III: points drawn uniformly from each finger's cloud, and steps around them.
        x = self._draw(self.human_clouds, config.points)
        d = STEP_SIGMA * torch.randn(x.shape, generator=self.generator).to(self.device)
        pinching, pinch_weights = self._pinches()
        hands = self._hands(config.frames)
        # One pass through the networks is faster than one per criterion.
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
        """Draws hands (N, F, 3) for criterion IV; also returns the weights (N, P) of their pairs."""
        config = self.config
        if config.resampling == "independent":
            hands = self._hands(config.pinches)
            return hands, self._pinch_weights_of(hands)
        rows = self._rows(self.pinch_rows, config.pinches)
        return self.frames[rows], self.pinch_weights[rows]

    def _hands(self, count: int) -> torch.Tensor:
        """Draws hands (N, F, 3): recorded frames, or each finger from its own cloud."""
        if self.config.resampling == "independent":
            return self._draw(self.human_clouds, count)
        return self.frames[self._rows(self.all_rows, count)]

    def _pinch_weights_of(self, hands: torch.Tensor) -> torch.Tensor:
        config = self.config
        return criteria.pinch_weights(hands, self.pairs, PINCH_M, config.other_pinches)

    def _refresh_classifier(self) -> None:
        """Refits the classifier, also to the retargeter's current outputs and samples around them."""
        assert self.collides is not None  # otherwise there are no refreshes
        started = time.perf_counter()
        with torch.no_grad():
            q = self.network(self._hands(REFRESH_SAMPLES))
            if not torch.isfinite(q).all():
                return  # the following check of the loss stops the run
            noise = torch.randn(q.shape, generator=self.generator).to(self.device)
            near = q + REFRESH_SIGMA * noise
            lower, upper = self._tensor(self.kinematics.lower), self._tensor(self.kinematics.upper)
            q = torch.cat([q, torch.clamp(near, lower, upper)])
        label = np.asarray(self.collides(q.cpu().numpy().astype(float)), dtype=float)
        # Earlier labels are kept, so that the map cannot return to known collisions unnoticed.
        self.own = (torch.cat([self.own[0], q]), torch.cat([self.own[1], self._tensor(label)]))
        refit_classifier(self.classifier, self.uniform, self.own, self.generator, REFRESH_STEPS)
        self.timings["refresh_s"] = self.timings.get("refresh_s", 0.0) + time.perf_counter() - started

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.tensor(array, dtype=torch.float32, device=self.device)

    def _rows(self, rows: torch.Tensor, count: int) -> torch.Tensor:
        if len(rows) == 0:
            return rows
        return rows[torch.randint(len(rows), (count,), generator=self.generator)]

    def _draw(self, clouds: Sequence[torch.Tensor], count: int) -> torch.Tensor:
        """Draws points (count, F, 3) from each finger's cloud independently."""
        return torch.stack(
            [cloud[torch.randint(len(cloud), (count,), generator=self.generator)] for cloud in clouds], dim=1
        )
