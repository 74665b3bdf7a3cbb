"""Trains `geort_coupled`; docs/concepts/derivations.md says where it departs from the paper, and why."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch

from geort_drake.errors import TrainingError
from geort_drake.processes import usable_cores
from geort_drake.retargeting.clouds import voxel_centres
from geort_drake.retargeting.methods.coupled import losses
from geort_drake.retargeting.methods.coupled.batches import COLLIDE_EVERY, Batch, Batches, BatchMaker
from geort_drake.retargeting.methods.coupled.coverage import AVERAGED, CoverageTargets
from geort_drake.retargeting.methods.coupled.hands import STEP_RANGE, TrainingHands
from geort_drake.retargeting.methods.coupled.multipliers import Prices
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.methods.coupled.violations import Shortfalls
from geort_drake.retargeting.methods.geort import TrainingConfig, TrainingResult
from geort_drake.retargeting.training.background import Beside
from geort_drake.retargeting.training.collision_geometry import CollisionGaps, CollisionShapes
from geort_drake.retargeting.training.criteria import direction_loss
from geort_drake.retargeting.training.descent import Report, descend, device_of, one_thread
from geort_drake.retargeting.training.kinematics import HandKinematics
from geort_drake.retargeting.training.pretraining import RobotSamples, check_robot_samples
from geort_drake.retargeting.training.soap import Soap

TIP_MARGIN = 0.003  # m; apart fingertips are kept this far from touching
WORTH_A_PROCESS = 300  # steps
# Of weights that follow. Hardly more of coverage: a part of a recording has less to cover with, and would
# pay in motion. No less of pinches: those that were not seen close less well than those that were.
FACTORS = {"coverage": (0.5, 1.1), "cross_talk": (0.5, 1.4), "pinch": (1.0, 3.0)}


@dataclass(frozen=True)
class CoupledConfig(TrainingConfig):
    """Settings of `train_coupled`. Weights are of ratios; `length_unit` and the classifier's are unused."""

    steps: int = 8600
    learning_rate: float = 0.017  # of SOAP, falls to zero along half a cosine
    points: int = 40  # real frames per finger and step at which that finger is moved
    targets: int = 48  # robot voxels per finger and step
    context_targets: int = 24  # the same, to be reached whatever the other fingers are doing
    pinches: int = 64  # real frames with a pinch per step, and as many made-up ones
    frames: int = 96  # real steps per step
    collisions: int = 48  # hands whose collisions are computed, in every other step
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
    coverage_radius: float = 0.010  # m
    motion_wanted: float = 0.9723  # mean cosine, also along recorded steps; see `Shortfalls`
    coverage_wanted: float = 0.785  # at 10 mm
    far_coverage_wanted: float = 0.945  # at 15 mm
    cross_talk_wanted: float = 0.0352
    closed_wanted: float = 0.5  # of pinches
    response_band: float = 0.6  # of log gain around its median
    pinch_wanted: float = 0.0105  # m; between a touch (two tip radii) and fingertips in one place
    pinch_scale: float = 0.008  # m
    pinch_reach: float = 0.030  # m; fingertips nearer than this are moved together to make up pinches
    pinch_spread: float = 0.005  # m; of the points at which made-up pinches meet
    pinch_offset_spread: float = 0.0  # m; of the offset between their tips, else as recorded
    strange_pinch_share: float = 0.8  # of made-up pinches: other fingers are from another instant
    strange_hand_share: float = 0.4  # of moved hands: other fingers are from instants of their own
    recorded_hand_share: float = 0.0  # of moved hands: whole hands, see `even_share`
    pinching_hand_share: float = 0.0  # of moved hands: made-up pinches
    even_share: float = 0.0  # of recorded hands: postures are alike, however long they were held
    posture_radius: float = 0.040  # m, over all fingertips; how near hands are the same posture
    spread: float = 0.006  # m; standard deviation by which the fingertips of some hands are displaced
    spread_share: float = 0.3  # which part of the moved hands and of the steps that is
    jitter: float = 0.004  # m; of the frames that must not collide
    collision_margin: float = 0.001  # m
    chain_margin: float = 0.001  # m; of a finger's own links, and of them and the palm, where it is less
    collision_scale: float = 0.005  # m
    robot_voxel: float = 0.005
    assign_every: int = 10  # steps between searches for the frames nearest to the robot's voxels
    weight_decay: float = 1e-2  # of the fingers' own networks
    residual_decay: float = 0.05
    averaging: float = 0.998  # of the weights, in the second half

    def validate(self) -> None:
        """Raises TrainingError where a value makes no sense."""
        super().validate()
        for name in ("motion_wanted", "coverage_wanted", "far_coverage_wanted", "closed_wanted"):
            if (value := getattr(self, name)) >= 1:
                raise TrainingError(f"training config: {name} must be below 1, it is {value}")
        shares = ("strange_hand_share", "recorded_hand_share", "pinching_hand_share")
        if (total := sum(getattr(self, name) for name in shares)) > 1 + 1e-9:
            raise TrainingError(
                f"training config: {', '.join(shares)} are of the same hands and must not exceed 1 together, "
                f"they are {total:g}"
            )
        if self.cross_talk_wanted <= 0:
            raise TrainingError(
                f"training config: cross_talk_wanted must be positive, it is {self.cross_talk_wanted}"
            )


def train_coupled(
    p_HF: np.ndarray,
    kinematics: HandKinematics,
    robot_samples: RobotSamples,
    config: TrainingConfig | None = None,
    seed: int = 0,
    device: str = "cpu",
    report: Report | None = None,
    shapes: CollisionShapes | None = None,
) -> TrainingResult:
    """Trains a map in which fingers see each other, without paired data.

    Args:
        p_HF: (T, F, 3) human fingertips in H, m, of successive frames; fingers as in `kinematics`.
        kinematics: exact kinematics of the robot hand.
        robot_samples: uniform samples of the robot's joint angles; labels are not used.
        config: a `CoupledConfig`; the defaults are meant for all recordings.
        seed: fixes the initial weights and every draw.
        device: "cpu" or "cuda".
        report: see `Report`.
        shapes: the hand's collision geometry; without it collisions are not avoided.

    Raises:
        TrainingError: on unusable input, or when the loss is not finite from the start. When it
            stops being finite later, the last good weights are returned with a RuntimeWarning.
            A finger that never pinches is named in a RuntimeWarning.
    """
    config = config or CoupledConfig()
    if not isinstance(config, CoupledConfig):
        raise TrainingError(f"geort_coupled takes a CoupledConfig, not a {type(config).__name__}")
    config.validate()
    if config.fk != "exact":
        raise TrainingError(f"geort_coupled trains with exact kinematics only, not with fk '{config.fk}'")
    if config.resampling != "frames":
        raise TrainingError("geort_coupled takes hands as they were recorded, not with resampled fingers")
    check_robot_samples(robot_samples, kinematics, labels=False)
    with one_thread():
        run = CoupledTraining(p_HF, kinematics, robot_samples, config, seed, device_of(device), shapes)
        return run.train(report)


class CoupledTraining:
    """The state of one training run; its network may be given weights before `train` moves them."""

    def __init__(
        self,
        p_HF: np.ndarray,
        kinematics: HandKinematics,
        samples: RobotSamples,
        config: CoupledConfig,
        seed: int,
        device: torch.device,
        shapes: CollisionShapes | None,
    ):
        self.config, self.kinematics = config, kinematics
        generator = torch.Generator().manual_seed(seed)
        self.hands = TrainingHands(p_HF, kinematics.finger_names, config, generator)
        q = torch.tensor(np.asarray(samples.q), dtype=torch.float32)
        with torch.no_grad():
            p_BF = kinematics.fingertips(q).numpy()
        voxels = [voxel_centres(p_BF[:, i], config.robot_voxel) for i in range(p_BF.shape[1])]
        space = CoverageTargets(self.hands.frames, kinematics, voxels, config.human_voxel, seed)
        gaps = None
        if shapes is not None and config.collision_weight > 0:
            allowance = max(config.collision_margin - config.chain_margin, 0.0)
            gaps = CollisionGaps(kinematics, shapes, allowance)
            gaps.keep_pairs_that_meet(q[:4000], config.collision_margin)
        self.device, self.gaps = device, gaps and gaps.to(device)
        # What is asked beside the descent; all of it is on the CPU.
        self.asked: dict[str, Callable] = {
            "batches": BatchMaker(self.hands, space, gaps, config),
            "shortfalls": Shortfalls(self.hands, kinematics, config, seed),
        }
        mean, scale = self.hands.mean, self.hands.scale
        self.network = CoupledNetwork(
            kinematics, mean, scale, config.hidden, config.residual_hidden, generator
        ).to(device)

    def train(self, report: Report | None) -> TrainingResult:
        config = self.config
        # A recording holds few of the ways in which fingers combine, so what combines them decays faster.
        groups = [
            {"params": [*self.network.mlp.parameters()], "weight_decay": config.weight_decay},
            {"params": [*self.network.residual.parameters()], "weight_decay": config.residual_decay},
        ]
        # A process starts in the time of some hundred steps.
        process = config.steps >= WORTH_A_PROCESS and usable_cores() > 1
        with Beside(self.asked, process) as beside:
            self.batches = Batches(partial(beside.start, "batches"), self.device)
            self.prices = Prices(FACTORS, partial(beside.start, "shortfalls"))
            descent = descend(
                self.network,
                self._losses,
                config.steps,
                config.learning_rate,
                report,
                Soap(groups, lr=config.learning_rate, clip=2.0),
                warm_up=50,
                averaging=config.averaging,
            )
        return TrainingResult(
            network=self.network.cpu(),
            history=descent.history,
            timings={"training_s": descent.seconds},
            stopped_at=descent.stopped_at,
            human_points=self.hands.points,
            pinch_frames=self.hands.pinch_frames,
        )

    def _losses(self, step: int) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """The weighted sum of the losses on one batch, and each of them."""
        config, progress = self.config, step / self.config.steps
        batch = self.batches.next(self.network, progress)
        if batch is None:
            return torch.tensor(math.nan), {}
        row = self._row(batch, self._answers(batch))
        scale = {"collision": COLLIDE_EVERY * min(max((progress - 0.15) / 0.25, 0.0), 1.0)}
        self.prices.follow(self.network, step, config.steps)
        scale |= self.prices.factors | {"context": self.prices.factors["coverage"]}
        weights = [scale.get(name, 1.0) * getattr(config, f"{name}_weight") for name in row]
        total = torch.stack([*row.values()]).dot(torch.tensor(weights, device=self.device))
        return total, row

    def _answers(self, batch: Batch) -> "_Answers":
        fingers, n = batch.d.shape[:2]
        ahead, behind = batch.moved.clone(), batch.moved.clone()
        _of_each(ahead, 2).add_(batch.d)
        _of_each(behind, 2).sub_(batch.d)
        # All fingers answer where they must not move, or meet; elsewhere the finger in question is enough.
        whole = [batch.moved.flatten(0, 1), ahead.flatten(0, 1), batch.before, batch.after, batch.pinching]
        whole.append(batch.crowd.hands if batch.crowd is not None else batch.before[:0])
        own = [behind, batch.covering, batch.contexts.flatten(1, 2)]
        angles = self.network.angles_apart(torch.cat(whole), torch.cat(own, dim=1))
        sizes = [len(hands) for hands in whole] + [hands.shape[1] for hands in own]
        p_BF = self.kinematics.fingertips_apart(angles).split(sizes, dim=1)
        here, ahead, before, after, pinching, _, behind, reached, alike = p_BF
        here, ahead = (tips.reshape(fingers, fingers, n, 3) for tips in (here, ahead))
        return _Answers(
            _of_each(here, 1),
            _of_each(ahead, 1),
            behind,
            (ahead - here).permute(1, 2, 0, 3),
            before.transpose(0, 1),
            after.transpose(0, 1),
            pinching.transpose(0, 1),
            reached,
            alike.reshape(fingers, -1, AVERAGED, 3).mean(2),
            self.network.in_order(angles.split(sizes, dim=1)[len(whole) - 1]),
        )

    def _row(self, batch: Batch, answers: "_Answers") -> dict[str, torch.Tensor]:
        """Each loss, without its weight."""
        config, pairs = self.config, self.hands.pairs
        moved = answers.ahead - answers.here
        step, answer = batch.after - batch.before, answers.after - answers.before
        long = step.norm(dim=-1) > STEP_RANGE[0]
        human_apart = losses.pair_distances(torch.cat([batch.after, batch.pinching]), pairs)
        robot_apart = losses.pair_distances(torch.cat([answers.after, answers.pinching]), pairs)
        pinched = robot_apart[len(batch.after) :]
        zero = moved.new_zeros(())
        row = {
            "direction": direction_loss(batch.d, moved),
            "track": direction_loss(step[long], answer[long]) if len(batch.after) else zero,
            "coverage": losses.bounded_coverage_loss(answers.reached, batch.targets, config.coverage_radius),
            "context": losses.bounded_coverage_loss(
                answers.averaged, batch.context_targets, config.coverage_radius
            )
            if config.context_weight > 0
            else zero,
            "cross_talk": losses.cross_talk_loss(answers.all_moved),
            "flatness": losses.curvature_loss(answers.ahead, answers.here, answers.behind),
            "response": losses.uniform_response_loss(batch.d, moved, config.response_band),
            "pinch": losses.pinch_distance_loss(
                pinched, batch.weights, config.pinch_wanted, config.pinch_scale
            ),
            "false_pinch": losses.false_pinch_loss(
                robot_apart,
                human_apart > 0.9 * config.pinch_reach,
                2 * self.kinematics.tip_radius + TIP_MARGIN,
                0.005,
            ),
            "collision": zero,
        }
        if batch.crowd is not None and self.gaps is not None:
            near = batch.crowd.row, batch.crowd.pair
            row["collision"] = self.gaps.loss(
                answers.crowd, *near, config.collision_margin, config.collision_scale
            )
        return row


@dataclass(frozen=True)
class _Answers:
    """Where the map puts the robot's fingertips for one batch, in B, m.

    Attributes:
        here, ahead, behind: (F, N, 3) of each finger that is moved, at x, x + d and x − d.
        all_moved: (F, N, F, 3) how far every fingertip moves from x to x + d.
        before, after, pinching: (M, F, 3) of whole hands.
        reached: (F, N, 3) what comes nearest to the targets.
        averaged: (F, N, 3) the same for the targets in context, averaged over the other fingers' hands.
        crowd: (M, n) joint angles of the hands that nearly collide, rad.
    """

    here: torch.Tensor
    ahead: torch.Tensor
    behind: torch.Tensor
    all_moved: torch.Tensor
    before: torch.Tensor
    after: torch.Tensor
    pinching: torch.Tensor
    reached: torch.Tensor
    averaged: torch.Tensor
    crowd: torch.Tensor


def _of_each(x: torch.Tensor, dim: int) -> torch.Tensor:
    """A view (F, N, 3) of x: for each number along axis 0, what has it along axis `dim` as well."""
    return x.diagonal(dim1=0, dim2=dim).movedim(-1, 0)
