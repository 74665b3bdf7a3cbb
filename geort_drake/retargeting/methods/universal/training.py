"""Trains a map for everyone: most coverage subject to constraints, on a population of people."""

from dataclasses import dataclass

import numpy as np
import torch

from geort_drake.errors import TrainingError
from geort_drake.people.population import sample_population
from geort_drake.retargeting.clouds import voxel_centres
from geort_drake.retargeting.methods.universal import collisions
from geort_drake.retargeting.methods.universal.config import CONSTRAINTS, UniversalConfig
from geort_drake.retargeting.methods.universal.constraints import Multipliers
from geort_drake.retargeting.methods.universal.coverage import CoverageTargets
from geort_drake.retargeting.methods.universal.losses import RobotTips, constraint_terms
from geort_drake.retargeting.methods.universal.network import UniversalNetwork, relative_to_knuckles
from geort_drake.retargeting.methods.universal.people import Hands, TrainingPeople
from geort_drake.retargeting.training.collision_geometry import CollisionGaps, CollisionShapes
from geort_drake.retargeting.training.descent import Report, descend, one_thread
from geort_drake.retargeting.training.kinematics import HandKinematics
from geort_drake.retargeting.training.soap import Soap

ROBOT_SAMPLES, ROBOT_VOXEL = 60_000, 0.005  # of the robot's C-space; m
COVERAGE_WEIGHT = 4.0
PEOPLE_PER_BATCH = 24
WEIGHT_DECAY = 0.01
MOMENTUM = (0.95, 0.99)  # gradients differ from person to person
AVERAGING = 0.997  # of the weights, in the second half


@dataclass(frozen=True)
class UniversalTraining:
    """A trained map for everyone.

    Attributes:
        arrays: of the network and of the average person, as `UniversalRetargeter` takes them.
        figures: running mean of each constraint's figure at the end, and "coverage".
        seconds: wall time of the descent.
    """

    arrays: dict[str, np.ndarray]
    figures: dict[str, float]
    seconds: float


def train_universal(
    kinematics: HandKinematics,
    shapes: CollisionShapes,
    config: UniversalConfig | None = None,
    seed: int = 0,
    report: Report | None = None,
) -> UniversalTraining:
    """Trains a map for everyone on the population of `geort_drake.people.population`.

    Args:
        kinematics, shapes: of the robot hand, mirrored for a left one.
        config: settings; None takes the defaults.
        seed: of the population, the initial weights and all draws.
        report: see `Report`.

    Raises:
        TrainingError: a setting is out of range, the hand has no thumb, or the loss is not finite at the
            first step.
    """
    config = config or UniversalConfig()
    config.validate()
    if "thumb" not in kinematics.finger_names:
        raise TrainingError(f"the hand has no thumb among its fingers {', '.join(kinematics.finger_names)}")
    p_HK = sample_population(config.people, seed)
    with one_thread():
        return _Training(kinematics, shapes, config, p_HK, seed).run(report)


class _Training:
    """The state of one training."""

    def __init__(
        self,
        kinematics: HandKinematics,
        shapes: CollisionShapes,
        config: UniversalConfig,
        p_HK: np.ndarray,
        seed: int,
    ):
        generator = torch.Generator().manual_seed(seed)
        self.config, self.kinematics = config, kinematics
        self.people = people = TrainingPeople(p_HK, kinematics.finger_names, generator, seed)
        lower, upper = torch.tensor(kinematics.lower).float(), torch.tensor(kinematics.upper).float()
        q = lower + (upper - lower) * torch.rand(ROBOT_SAMPLES, len(lower), generator=generator)
        tips = kinematics.fingertips(q).numpy()
        voxels = [
            torch.tensor(voxel_centres(tips[:, i], ROBOT_VOXEL), dtype=torch.float32)
            for i in range(tips.shape[1])
        ]
        gaps = CollisionGaps(kinematics, shapes)
        gaps.keep_pairs_that_meet(q[:4000], collisions.MARGIN)
        self.collisions = collisions.NearCollisions(people, gaps)
        self.coverage = CoverageTargets(people, kinematics, voxels, generator)
        codes = people.codes.flatten(0, 1)
        x = relative_to_knuckles(people.p_HF, people.codes[:, 1]).flatten(0, 1)
        self.network = UniversalNetwork(kinematics, codes, x, people.pairs, generator)
        self.multipliers = Multipliers({name: getattr(config, name) for name in CONSTRAINTS})
        self.covered = 0.0

    def run(self, report: Report | None) -> UniversalTraining:
        config = self.config
        groups = self.network.groups(WEIGHT_DECAY)
        descent = descend(
            self.network,
            self._losses,
            config.steps,
            config.learning_rate,
            report,
            Soap(groups, lr=config.learning_rate, betas=MOMENTUM, clip=2.0),
            warm_up=100,
            averaging=AVERAGING,
        )
        if descent.stopped_at is not None:
            raise TrainingError(f"the loss stopped being finite at step {descent.stopped_at}")
        arrays = self.network.arrays() | self.people.average.arrays()
        figures = self.multipliers.figures | {"coverage": self.covered}
        return UniversalTraining(arrays, figures, descent.seconds)

    def _losses(self, step: int) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """The Lagrangian on one batch, and each loss."""
        hands = self.people.draw(PEOPLE_PER_BATCH)
        terms = constraint_terms(hands, self._answers(hands), self.people, self.kinematics.tip_radius)
        losses = {name: loss for name, (loss, _) in terms.items()}
        figures = {name: figure for name, (_, figure) in terms.items()}
        if step % collisions.SEARCH_EVERY == 0:
            figures["collision"] = self.collisions.search(self.network, hands)
        if step % collisions.EVERY == 0:
            losses["collision"] = self.collisions.loss(self.network)
        self.multipliers.update(figures)
        total = sum(self.multipliers.values[name] * loss for name, loss in losses.items())
        losses["coverage"] = self.coverage.loss(self.network)
        self.covered += 0.02 * (self.coverage.reached - self.covered)
        return total + COVERAGE_WEIGHT * losses["coverage"], losses

    def _answers(self, hands: Hands) -> RobotTips:
        d = torch.nn.functional.one_hot(hands.finger, hands.moved.shape[2])[..., None] * hands.d[:, :, None]
        every = [hands.moved, hands.moved + d, hands.moved - d, hands.before, hands.after, hands.pinching]
        q = self.network(torch.cat(every, 1), hands.codes)
        tips = self.kinematics.fingertips(q).split([part.shape[1] for part in every], dim=1)
        return RobotTips(*tips)
