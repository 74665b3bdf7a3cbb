"""Trains maps to maximise coverage under constraints, for one person or for a population.

docs/concepts/derivations.md explains the differences from the paper.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from geort_drake.errors import TrainingError
from geort_drake.people.keypoints import TIP_KEYPOINT
from geort_drake.people.population import sample_population
from geort_drake.retargeting.clouds import voxel_centres
from geort_drake.retargeting.method import TrainingData, TrainingResult
from geort_drake.retargeting.methods.coupled import collisions
from geort_drake.retargeting.methods.coupled.config import CONSTRAINTS, UNIVERSAL_CONFIG, CoupledConfig, Start
from geort_drake.retargeting.methods.coupled.constraints import Multipliers
from geort_drake.retargeting.methods.coupled.coverage import CoverageTargets
from geort_drake.retargeting.methods.coupled.losses import TOUCH, RobotTips, constraint_terms
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.methods.coupled.people import Hands, TrainingPeople
from geort_drake.retargeting.methods.coupled.population import WHOLE, code_people
from geort_drake.retargeting.methods.coupled.universal_network import UniversalNetwork, relative_to_knuckles
from geort_drake.retargeting.training.collision_geometry import CollisionGaps, CollisionShapes
from geort_drake.retargeting.training.descent import Descent, Report, descend, device_of, one_thread
from geort_drake.retargeting.training.human_data import HumanData, pinch_pairs
from geort_drake.retargeting.training.kinematics import HandKinematics
from geort_drake.retargeting.training.soap import Soap

ROBOT_SAMPLES, ROBOT_VOXEL = 60_000, 0.005  # samples of the robot's C-space, and their voxels, m
COVERAGE_WEIGHT = 4.0
PEOPLE_PER_BATCH, PEOPLE_PER_REFIT_BATCH = 24, 10
WEIGHT_DECAY = 0.01
MOMENTUM = (0.95, 0.99)  # high, because gradients differ between people
# Deviation of synthetic pinches from recorded ones, m; one person's recording covers fewer positions.
PINCH_SPREAD, PINCH_SPREAD_OF_ONE = 0.005, 0.010
LIKELY_WEIGHT = 0.5  # of a likely hand in a refit, relative to a recorded one
# Settings of the multipliers. A short training has no time to correct multipliers that rose too far.
POPULATION = {"start": 3.0, "rate": 0.02, "proportion": 0.0}
ONE_PERSON = {"start": 1.0, "rate": 0.005, "proportion": 1.0}
AVERAGED_STEPS = 90  # time constant of the exponential average of the weights


@dataclass(frozen=True)
class UniversalTraining:
    """A trained universal map.

    Attributes:
        arrays: arrays of the network and of the average person for `UniversalRetargeter`.
        figures: final running mean of each constraint's figure, and of "coverage".
        seconds: wall time of the descent, s.
    """

    arrays: dict[str, np.ndarray]
    figures: dict[str, float]
    seconds: float


def train(
    data: TrainingData,
    config: CoupledConfig,
    seed: int,
    device: str,
    report: Report | None,
    start: Start | None = None,
) -> TrainingResult:
    """See `train_coupled`."""
    if not isinstance(config, CoupledConfig):
        raise TrainingError(f"geort_coupled takes a CoupledConfig, not a {type(config).__name__}")
    config.validate()
    data.check_q()
    kinematics, dev = data.kinematics, device_of(device)
    human = HumanData(data.p_HF, kinematics.finger_names)
    human.check_pinches()
    if not human.pairs:
        raise TrainingError(f"geort_coupled trains hands of two fingers or more, not of {human.finger_names}")
    generator, rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
    network = CoupledNetwork(kinematics, torch.tensor(human.mean), torch.tensor(human.scale), generator)
    if start is not None:
        network.set_arrays(start.arrays)
    p_HF, weights = np.asarray(data.p_HF, dtype=np.float32)[None], [1]
    if start is not None:
        likely = start.p_HF[:, np.arange(p_HF.shape[1]) % start.p_HF.shape[1]]
        p_HF = np.concatenate([p_HF, likely.astype(np.float32)])
        own = p_HF.shape[1] * len(likely) / (LIKELY_WEIGHT * start.p_HF.shape[1])
        weights = [max(round(own), 1)] + [1] * len(likely)
    people = TrainingPeople(
        p_HF,
        human.pairs,
        generator,
        rng,
        codes=torch.zeros(len(p_HF), 1, 0),
        reach=torch.ones(p_HF.shape[0], p_HF.shape[2]),
        pinch_spread=PINCH_SPREAD_OF_ONE,
        weights=weights,
        device=dev,
    )
    with one_thread():
        q = torch.tensor(np.asarray(data.q), dtype=torch.float32)
        shapes = None if data.shapes is None else data.shapes()
        batch = PEOPLE_PER_BATCH if start is None else PEOPLE_PER_REFIT_BATCH
        training = _Training(
            network.to(dev), people, kinematics, shapes, q, config, ONE_PERSON, generator, batch
        )
        descent = training.run(report)
    return TrainingResult(
        network=network.cpu(),
        history=descent.history,
        timings={"training_s": descent.seconds},
        stopped_at=descent.stopped_at,
        human_points=human.points,
        pinch_frames=people.pinch_frames,
    )


def train_universal(
    kinematics: HandKinematics,
    shapes: CollisionShapes,
    config: CoupledConfig = UNIVERSAL_CONFIG,
    people: int = 800,
    seed: int = 0,
    device: str = "cpu",
    report: Report | None = None,
) -> UniversalTraining:
    """Trains a universal map on the population of `geort_drake.people.population`.

    Args:
        kinematics, shapes: kinematics and collision shapes of the robot hand, mirrored for a left hand.
        config: settings of the training.
        people: number of people in the population.
        seed: seed of the population, the initial weights and all draws.
        device: "cpu" or "cuda".
        report: see `Report`.

    Raises:
        TrainingError: a setting is out of range, the hand has no thumb or no other finger, or the loss is not
            finite at some step.
    """
    config.validate()
    if people < 1:
        raise TrainingError(f"training: people must be at least 1, they are {people}")
    names, dev = kinematics.finger_names, device_of(device)
    if "thumb" not in names or len(names) < 2:
        raise TrainingError(f"the hand needs a thumb and another finger, it has {', '.join(names)}")
    generator, rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
    p_HK = sample_population(people, seed)
    coded = code_people(p_HK, names, rng)
    p_HF = p_HK[:, :, [TIP_KEYPOINT[name] for name in names]]
    drawn = TrainingPeople(
        p_HF, pinch_pairs(names), generator, rng, coded.codes, coded.reach, PINCH_SPREAD, [1] * people, dev
    )
    with one_thread():
        lower, upper = torch.tensor(kinematics.lower).float(), torch.tensor(kinematics.upper).float()
        q = lower + (upper - lower) * torch.rand(ROBOT_SAMPLES, len(lower), generator=generator)
        x = relative_to_knuckles(torch.tensor(p_HF), coded.codes[:, WHOLE]).flatten(0, 1)
        network = UniversalNetwork(kinematics, coded.codes.flatten(0, 1), x, drawn.pairs, generator)
        training = _Training(network.to(dev), drawn, kinematics, shapes, q, config, POPULATION, generator)
        descent = training.run(report)
    if descent.stopped_at is not None:
        raise TrainingError(f"the loss stopped being finite at step {descent.stopped_at}")
    figures = training.multipliers.figures | {"coverage": training.covered}
    return UniversalTraining(network.cpu().arrays() | coded.average.arrays(), figures, descent.seconds)


class _Training:
    """The state of a training."""

    def __init__(
        self,
        network: CoupledNetwork | UniversalNetwork,
        people: TrainingPeople,
        kinematics: HandKinematics,
        shapes: CollisionShapes | None,
        q: torch.Tensor,
        config: CoupledConfig,
        gains: Mapping[str, float],
        generator: torch.Generator,
        batch: int = PEOPLE_PER_BATCH,
    ):
        """Takes random joint angles q (N, n), rad, and the number of people per batch. Without `shapes`,
        collisions are ignored."""
        self.network, self.people, self.kinematics, self.config = network, people, kinematics, config
        with torch.no_grad():
            tips = kinematics.fingertips(q)
        nearest = people.pair_distances(tips.to(people.device)).amin(0)
        people.closable = nearest < TOUCH * kinematics.tip_radius
        voxels = [
            torch.tensor(voxel_centres(tip.numpy(), ROBOT_VOXEL), dtype=torch.float32, device=people.device)
            for tip in tips.unbind(1)
        ]
        self.collisions = None
        if shapes is not None:
            gaps = CollisionGaps(kinematics, shapes)
            gaps.keep_pairs_that_meet(q[:4000], collisions.MARGIN)
            self.collisions = collisions.NearCollisions(people, gaps.to(people.device))
        self.coverage = CoverageTargets(people, kinematics, voxels, generator)
        self.multipliers = Multipliers({name: getattr(config, name) for name in CONSTRAINTS}, **gains)
        self.covered, self._batch = 0.0, batch

    def run(self, report: Report | None) -> Descent:
        config = self.config
        groups = self.network.groups(WEIGHT_DECAY)
        return descend(
            self.network,
            self._losses,
            config.steps,
            config.learning_rate,
            report,
            Soap(groups, lr=config.learning_rate, betas=MOMENTUM, clip=2.0),
            warm_up=min(100, config.steps // 10),
            averaging=max(1.0 - AVERAGED_STEPS / config.steps, 0.0),
            is_fixed=False,
        )

    def _losses(self, step: int) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Computes the Lagrangian on one batch, and its losses by name."""
        hands = self.people.draw(self._batch)
        robot = self._robot_tips(hands)
        if robot is None:
            return torch.tensor(math.nan), {}
        terms = constraint_terms(hands, robot, self.people, self.kinematics)
        losses = {name: loss for name, (loss, _) in terms.items()}
        figures = {name: figure for name, (_, figure) in terms.items()}
        if self.collisions is not None:
            if step % collisions.SEARCH_EVERY == 0:
                figures["collision"] = self.collisions.search(self.network, hands)
            if step % collisions.EVERY == 0:
                losses["collision"] = self.collisions.loss(self.network)
        self.multipliers.update(figures)
        total = sum(self.multipliers.values[name] * loss for name, loss in losses.items())
        losses["coverage"] = self.coverage.loss(self.network)
        self.covered += 0.02 * (self.coverage.reached - self.covered)
        return total + COVERAGE_WEIGHT * losses["coverage"], losses

    def _robot_tips(self, hands: Hands) -> RobotTips | None:
        """Computes the robot's fingertips under the map; None if joint angles are not finite."""
        d = torch.nn.functional.one_hot(hands.finger, hands.moved.shape[2])[..., None] * hands.d[:, :, None]
        parts = [hands.moved, hands.moved + d, hands.moved - d, hands.before, hands.after, hands.pinching]
        q = self.network(torch.cat(parts, 1), hands.codes)
        if not torch.isfinite(q).all():
            return None
        tips = self.kinematics.fingertips(q).split([part.shape[1] for part in parts], dim=1)
        return RobotTips(*tips)
