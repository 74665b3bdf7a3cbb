"""Trains `geort_coupled`; docs/concepts/derivations.md explains its differences from the paper."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch

from geort_drake.errors import TrainingError
from geort_drake.processes import usable_cores
from geort_drake.retargeting.clouds import voxel_centres
from geort_drake.retargeting.method import TrainingData, TrainingResult
from geort_drake.retargeting.methods.coupled.batches import COLLIDE_EVERY, Batch, Batches, BatchMaker
from geort_drake.retargeting.methods.coupled.config import CoupledConfig
from geort_drake.retargeting.methods.coupled.coverage import AVERAGED, CoverageTargets
from geort_drake.retargeting.methods.coupled.hands import PINCH_REACH, STEP_RANGE, TrainingHands
from geort_drake.retargeting.methods.coupled.losses import (
    bounded_coverage_loss,
    cross_talk_loss,
    curvature_loss,
    false_pinch_loss,
    pair_distances,
    pinch_distance_loss,
    uniform_response_loss,
)
from geort_drake.retargeting.methods.coupled.multipliers import LagrangeMultipliers
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.methods.coupled.violations import ConstraintViolations
from geort_drake.retargeting.training.background import BackgroundProcess
from geort_drake.retargeting.training.collision_geometry import CollisionGaps
from geort_drake.retargeting.training.criteria import direction_loss
from geort_drake.retargeting.training.descent import Report, descend, device_of, one_thread
from geort_drake.retargeting.training.soap import Soap

ROBOT_VOXEL = 0.005  # m
COVERAGE_RADIUS = 0.010  # m; a target at this distance counts half
RESPONSE_BAND = 0.6  # of log gain around its median
PINCH_TARGET = 0.0105  # m; between a touch (two tip radii) and fingertips in one place
TIP_MARGIN = 0.003  # m; fingertips that the person holds apart keep this distance from touching
FALSE_PINCH_SCALE = 0.005  # m
COLLISION_SCALE = 0.005  # m
CHAIN_MARGIN = 0.001  # m; upper bound of the collision margin within a finger, and between finger and palm
WEIGHT_DECAY = 0.01  # of the fingers' own networks
RESIDUAL_DECAY = 0.05
MIN_STEPS_FOR_PROCESS = 300  # a process starts in the time of some hundred steps
# Least and greatest factors of weights. Coverage hardly rises: a part of a recording has less to cover with,
# and would lose motion preservation. Pinches never fall: unseen ones close less well than those of the
# recording.
FACTORS = {"coverage": (0.5, 1.1), "cross_talk": (0.5, 1.4), "pinch": (1.0, 3.0)}


def train(
    data: TrainingData,
    config: CoupledConfig,
    seed: int,
    device: str,
    report: Report | None,
    start: Mapping[str, np.ndarray] | None = None,
) -> TrainingResult:
    """See `train_coupled`."""
    if not isinstance(config, CoupledConfig):
        raise TrainingError(f"geort_coupled takes a CoupledConfig, not a {type(config).__name__}")
    config.validate()
    data.check_q()
    with one_thread():
        training = _Training(data, config, seed, device_of(device))
        if start is not None:
            training.network.set_arrays(start)
        return training.run(report)


class _Training:
    """The state of one training."""

    def __init__(self, data: TrainingData, config: CoupledConfig, seed: int, device: torch.device):
        kinematics = data.kinematics
        self.config, self.kinematics = config, kinematics
        generator = torch.Generator().manual_seed(seed)
        self.hands = TrainingHands(data.p_HF, kinematics.finger_names, config, generator)
        q = torch.tensor(np.asarray(data.q), dtype=torch.float32)
        with torch.no_grad():
            p_BF = kinematics.fingertips(q).numpy()
        voxels = [voxel_centres(p_BF[:, i], ROBOT_VOXEL) for i in range(p_BF.shape[1])]
        space = CoverageTargets(self.hands.frames, kinematics, voxels, seed)
        gaps = None
        if data.shapes is not None and config.collision_weight > 0:
            allowance = max(config.collision_margin - CHAIN_MARGIN, 0.0)
            gaps = CollisionGaps(kinematics, data.shapes(), allowance)
            gaps.keep_pairs_that_meet(q[:4000], config.collision_margin)
        self.device, self.gaps = device, gaps and gaps.to(device)
        # Called in the background, on the CPU.
        self.background: dict[str, Callable] = {
            "batches": BatchMaker(self.hands, space, gaps, config),
            "violations": ConstraintViolations(self.hands, kinematics, config, seed),
        }
        mean, scale = self.hands.mean, self.hands.scale
        self.network = CoupledNetwork(
            kinematics, mean, scale, config.hidden, config.residual_hidden, generator
        ).to(device)

    def run(self, report: Report | None) -> TrainingResult:
        config = self.config
        # A recording shows few combinations of fingers, so the residual, which combines them, decays faster.
        groups = [
            {"params": [*self.network.mlp.parameters()], "weight_decay": WEIGHT_DECAY},
            {"params": [*self.network.residual.parameters()], "weight_decay": RESIDUAL_DECAY},
        ]
        separate = config.steps >= MIN_STEPS_FOR_PROCESS and usable_cores() > 1
        with BackgroundProcess(self.background, separate) as background:
            self.batches = Batches(partial(background.start, "batches"), self.device)
            self.multipliers = LagrangeMultipliers(FACTORS, partial(background.start, "violations"))
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
        row = self._terms(batch, self._answers(batch))
        scale = {"collision": COLLIDE_EVERY * min(max((progress - 0.15) / 0.25, 0.0), 1.0)}
        self.multipliers.update(self.network, step, config.steps)
        scale |= self.multipliers.factors | {"context": self.multipliers.factors["coverage"]}
        weights = [scale.get(name, 1.0) * getattr(config, f"{name}_weight") for name in row]
        total = torch.stack([*row.values()]).dot(torch.tensor(weights, device=self.device))
        return total, row

    def _answers(self, batch: Batch) -> "_Answers":
        fingers, n = batch.d.shape[:2]
        ahead, behind = batch.moved.clone(), batch.moved.clone()
        _of_each(ahead, 2).add_(batch.d)
        _of_each(behind, 2).sub_(batch.d)
        # All fingers are needed for cross-talk, pinches and collisions; elsewhere only the moved finger.
        whole = [batch.moved.flatten(0, 1), ahead.flatten(0, 1), batch.before, batch.after, batch.pinching]
        whole.append(batch.near_collisions.hands if batch.near_collisions is not None else batch.before[:0])
        own = [behind, batch.covering, batch.contexts.flatten(1, 2)]
        angles = self.network.angles_by_finger(torch.cat(whole), torch.cat(own, dim=1))
        sizes = [len(hands) for hands in whole] + [hands.shape[1] for hands in own]
        p_BF = self.kinematics.fingertips_by_finger(angles).split(sizes, dim=1)
        here, ahead, before, after, pinching, _, behind, reached, in_contexts = p_BF
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
            in_contexts.reshape(fingers, -1, AVERAGED, 3).mean(2),
            self.network.in_order(angles.split(sizes, dim=1)[len(whole) - 1]),
        )

    def _terms(self, batch: Batch, answers: "_Answers") -> dict[str, torch.Tensor]:
        """Each loss, without its weight."""
        config, pairs = self.config, self.hands.pairs
        moved = answers.ahead - answers.here
        step, answer = batch.after - batch.before, answers.after - answers.before
        long = step.norm(dim=-1) > STEP_RANGE[0]
        human_apart = pair_distances(torch.cat([batch.after, batch.pinching]), pairs)
        robot_apart = pair_distances(torch.cat([answers.after, answers.pinching]), pairs)
        pinched = robot_apart[len(batch.after) :]
        zero = moved.new_zeros(())
        row = {
            "direction": direction_loss(batch.d, moved),
            "track": direction_loss(step[long], answer[long]) if len(batch.after) else zero,
            "coverage": bounded_coverage_loss(answers.reached, batch.targets, COVERAGE_RADIUS),
            "context": bounded_coverage_loss(answers.averaged, batch.context_targets, COVERAGE_RADIUS)
            if config.context_weight > 0
            else zero,
            "cross_talk": cross_talk_loss(answers.all_moved),
            "flatness": curvature_loss(answers.ahead, answers.here, answers.behind),
            "response": uniform_response_loss(batch.d, moved, RESPONSE_BAND),
            "pinch": pinch_distance_loss(pinched, batch.weights, PINCH_TARGET, config.pinch_scale),
            "false_pinch": false_pinch_loss(
                robot_apart,
                human_apart > 0.9 * PINCH_REACH,
                2 * self.kinematics.tip_radius + TIP_MARGIN,
                FALSE_PINCH_SCALE,
            ),
            "collision": zero,
        }
        if batch.near_collisions is not None and self.gaps is not None:
            near = batch.near_collisions.row, batch.near_collisions.pair
            row["collision"] = self.gaps.loss(
                answers.near_collisions, *near, config.collision_margin, COLLISION_SCALE
            )
        return row


@dataclass(frozen=True)
class _Answers:
    """Where the map puts the robot's fingertips for one batch, in B, m.

    Attributes:
        here, ahead, behind: (F, N, 3) of each moved finger, at x, x + d and x − d.
        all_moved: (F, N, F, 3) how far every fingertip moves from x to x + d.
        before, after, pinching: (M, F, 3) of whole hands.
        reached: (F, N, 3) the points nearest to the targets.
        averaged: (F, N, 3) the same for the targets in context, averaged over the other fingers' poses.
        near_collisions: (M, n) joint angles of the hands that nearly collide, rad.
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
    near_collisions: torch.Tensor


def _of_each(x: torch.Tensor, dim: int) -> torch.Tensor:
    """A view (F, N, 3) of x (F, …): for each index of axis 0, the entry with the same index of axis `dim`."""
    return x.diagonal(dim1=0, dim2=dim).movedim(-1, 0)
