"""Trains `geort_coupled`; docs/derivations.md says where it departs from the paper, and why."""

import copy
import math
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch

from geort_drake.errors import TrainingError
from geort_drake.retargeting import coupled_losses as losses
from geort_drake.retargeting.clouds import voxel_centres
from geort_drake.retargeting.collision_geometry import CollisionGaps, CollisionShapes
from geort_drake.retargeting.coupled_coverage import AVERAGED, CoverageTargets
from geort_drake.retargeting.coupled_hands import STEP_RANGE, TrainingHands
from geort_drake.retargeting.coupled_network import CoupledNetwork
from geort_drake.retargeting.criteria import direction_loss
from geort_drake.retargeting.descent import Report, descend, device_of, one_thread
from geort_drake.retargeting.kinematics import HandKinematics
from geort_drake.retargeting.pretraining import RobotSamples, check_robot_samples
from geort_drake.retargeting.soap import Soap
from geort_drake.retargeting.training import TrainingConfig, TrainingResult

TIP_MARGIN = 0.002  # m; apart fingertips are kept this far from touching
CROWDED = 600  # how many hands are looked through for near collisions at a time
REMEMBERED = 2000  # how many of those that nearly collided are kept


@dataclass(frozen=True)
class CoupledConfig(TrainingConfig):
    """Settings of `train_coupled`. Weights are of ratios; `length_unit` and the classifier's are unused."""

    steps: int = 6000
    learning_rate: float = 0.02  # of SOAP, falls to zero along half a cosine
    points: int = 40  # real frames per finger and step at which that finger is moved
    targets: int = 48  # robot voxels per finger and step
    context_targets: int = 32  # the same, to be reached whatever the other fingers are doing
    pinches: int = 64  # real frames with a pinch per step, and as many made-up ones
    frames: int = 96  # real steps per step
    collisions: int = 48  # frames per step whose collisions are computed
    hidden: int = 64
    residual_hidden: int = 96
    direction_weight: float = 2.7
    track_weight: float = 5.9
    coverage_weight: float = 1.42
    context_weight: float = 1.63
    cross_talk_weight: float = 3.4
    flatness_weight: float = 0.62
    response_weight: float = 0.8
    pinch_weight: float = 1.2
    false_pinch_weight: float = 0.3
    collision_weight: float = 0.2
    coverage_radius: float = 0.010  # m
    response_band: float = 0.6  # of log gain around its median
    pinch_wanted: float = 0.010  # m; between a touch (two tip radii) and fingertips in one place
    pinch_scale: float = 0.008  # m
    pinch_reach: float = 0.030  # m; fingertips nearer than this are moved together to make up pinches
    pinch_spread: float = 0.005  # m; of the points at which made-up pinches meet
    strange_pinch_share: float = 0.8  # of made-up pinches: other fingers are from another instant
    strange_hand_share: float = 0.4  # of moved hands: other fingers are from instants of their own
    spread: float = 0.006  # m; standard deviation by which the fingertips of some hands are displaced
    spread_share: float = 0.15  # which part of the moved hands and of the steps that is
    jitter: float = 0.004  # m; of the frames that must not collide
    collision_margin: float = 0.001  # m
    collision_scale: float = 0.005  # m
    robot_voxel: float = 0.005
    assign_every: int = 10  # steps between searches for the frames nearest to the robot's voxels
    weight_decay: float = 1e-2  # of the fingers' own networks
    residual_decay: float = 0.05
    averaging: float = 0.998  # of the weights, in the second half


def train_coupled(
    p_HF: np.ndarray,
    kinematics: HandKinematics,
    robot_samples: RobotSamples,
    config: TrainingConfig | None = None,
    seed: int = 0,
    device: str = "cpu",
    report: Report | None = None,
    collides_beyond_tips=None,
    shapes: CollisionShapes | None = None,
) -> TrainingResult:
    """Trains a map in which fingers see each other, without paired data.

    Args:
        p_HF: (T, F, 3) human fingertips in H, m, of successive frames; fingers as in `kinematics`.
        kinematics: exact kinematics of the robot hand.
        robot_samples: uniform samples of the robot's joint angles.
        config: a `CoupledConfig`; the defaults are meant for all recordings.
        seed: fixes the initial weights and every draw.
        device: "cpu" or "cuda".
        report: called as report(step, steps, row of losses) about a hundred times.
        collides_beyond_tips: not used, as collisions come from `shapes`.
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
    check_robot_samples(robot_samples, kinematics)
    with one_thread():
        run = _Run(p_HF, kinematics, robot_samples, config, seed, device_of(device), shapes)
        return run.train(report)


class _Run:
    """The state of one training run."""

    def __init__(self, p_HF, kinematics, samples, config: CoupledConfig, seed, device, shapes):
        self.config, self.kinematics = config, kinematics
        generator = torch.Generator().manual_seed(seed)
        self.hands = TrainingHands(p_HF, kinematics.finger_names, config, generator, device)
        q = torch.tensor(np.asarray(samples.q), dtype=torch.float32, device=device)
        with torch.no_grad():
            p_BF = kinematics.fingertips(q).cpu().numpy()
        voxels = [voxel_centres(p_BF[:, i], config.robot_voxel) for i in range(p_BF.shape[1])]
        self.space = CoverageTargets(self.hands.frames, kinematics, voxels, config.human_voxel, seed)
        self._next: Future | None = None
        self.gaps = None
        self.crowded = self.hands.frames[:0]
        if shapes is not None and config.collision_weight > 0:
            self.gaps = CollisionGaps(kinematics, shapes, device)
            self.gaps.keep_pairs_that_meet(q[:4000], config.collision_margin)
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
        with ThreadPoolExecutor(1) as self._beside:
            descent = descend(
                self.network,
                self._losses,
                config.steps,
                config.learning_rate,
                report,
                Soap(groups, lr=config.learning_rate),
                warm_up=50,
                clip=2.0,
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

    def _renew(self, progress: float) -> bool:
        """Takes up what was found for the coming steps; False if the map was not finite."""
        # The search runs beside the descent, for a copy of the map, so what it found is some steps old.
        found = (self._next or self._start_search(progress)).result()
        self._next = self._start_search(progress)
        if found is None:
            return False
        self.assigned, touching = found
        self.crowded = torch.cat([touching, self.crowded])[:REMEMBERED]
        return True

    def _start_search(self, progress: float) -> Future:
        return self._beside.submit(self._search, copy.deepcopy(self.network), self._candidates(), progress)

    def _search(self, network: CoupledNetwork, hands: torch.Tensor, progress: float):
        """Which voxels to reach, and who should reach them; and those of the hands that nearly collide."""
        config = self.config
        with torch.no_grad():
            q = network(hands)
        if not torch.isfinite(q).all():
            return None
        voxels, rows = self.space.nearest(network, config.targets * config.assign_every)
        if config.context_weight > 0:
            in_context = self.space.nearest_in_context(network, config.context_targets * config.assign_every)
        else:
            in_context = voxels[:, :0], hands[:0].reshape(len(voxels), 0, AVERAGED, *hands.shape[1:])
        if self.gaps is None or progress < 0.1:
            return (voxels, rows, *in_context), hands[:0]
        least = self.gaps.least(q, 3 * config.collision_margin)
        return (voxels, rows, *in_context), hands[least < 2 * config.collision_margin]

    def _candidates(self) -> torch.Tensor:
        """Hands in which something may touch: recorded ones, pinches and fingers put together."""
        pinches, _ = self.hands.made_up_pinches(CROWDED // 8)
        return torch.cat(
            [self.hands.recorded(3 * CROWDED // 4), pinches, self.hands.recombined(CROWDED // 8)]
        )

    def _losses(self, step: int) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """The weighted sum of the losses on one random batch, and each of them."""
        config = self.config
        progress = step / config.steps
        if step % config.assign_every == 0 and not self._renew(progress):
            return torch.tensor(math.nan), {}
        frames, pairs = self.hands.frames, self.hands.pairs
        fingers, n = frames.shape[1], config.points
        x, d = self.hands.one_moved(n)
        ahead, behind = x.clone(), x.clone()
        each = torch.arange(fingers)
        ahead[each, :, each] += d
        behind[each, :, each] -= d
        # This step's share of the robot voxels, and the real frames that should reach them.
        part = step % config.assign_every
        window = slice(part * config.targets, (part + 1) * config.targets)
        targets, cover = (found[:, window] for found in self.assigned[:2])
        window = slice(part * config.context_targets, (part + 1) * config.context_targets)
        context_targets, hands = (found[:, window] for found in self.assigned[2:])
        before, after = self.hands.steps(config.frames)
        pinching, weights = self.hands.pinches(config.pinches)
        # All fingers answer where they must not move, or meet; elsewhere the finger in question is enough.
        parts = [x.flatten(0, 1), ahead.flatten(0, 1), before, after, pinching, self._crowd()]
        q = self.network(torch.cat(parts)).split([len(part) for part in parts])
        p_BF = self.kinematics.fingertips(torch.cat(q[:-1])).split([len(part) for part in parts[:-1]])
        g_x, g_ahead = (p.reshape(fingers, n, fingers, 3) for p in p_BF[:2])
        g_before, g_after, g_pinching = p_BF[2:]
        own_x, own_ahead = g_x[each, :, each], g_ahead[each, :, each]
        parts = [behind, frames[cover], hands.flatten(1, 2)]
        own = self.kinematics.fingertips_apart(self.network.own_angles(torch.cat(parts, dim=1)))
        own_behind, reached, alike = own.split([part.shape[1] for part in parts], dim=1)
        averaged = alike.reshape(fingers, -1, AVERAGED, 3).mean(2)
        step_d, step_answer = after - before, g_after - g_before
        long = step_d.norm(dim=-1) > STEP_RANGE[0]
        human_apart = losses.pair_distances(torch.cat([after, pinching]), pairs)
        robot_apart = losses.pair_distances(torch.cat([g_after, g_pinching]), pairs)
        tips = 2 * self.kinematics.tip_radius
        zero = q[0].new_zeros(())
        row = {
            "direction": direction_loss(d, own_ahead - own_x),
            "track": direction_loss(step_d[long], step_answer[long]) if len(before) else zero,
            "coverage": losses.bounded_coverage_loss(reached, targets, config.coverage_radius),
            "context": losses.bounded_coverage_loss(averaged, context_targets, config.coverage_radius)
            if config.context_weight > 0
            else zero,
            "cross_talk": losses.cross_talk_loss(g_ahead - g_x),
            "flatness": losses.curvature_loss(own_ahead, own_x, own_behind),
            "response": losses.uniform_response_loss(d, own_ahead - own_x, config.response_band),
            "pinch": losses.pinch_distance_loss(
                robot_apart[len(after) :], weights, config.pinch_wanted, config.pinch_scale
            ),
            "false_pinch": losses.false_pinch_loss(
                robot_apart, human_apart > 0.9 * config.pinch_reach, tips + TIP_MARGIN, 0.005
            ),
            "collision": zero,
        }
        if self.gaps is not None and progress > 0.15:
            row["collision"] = self.gaps.loss(q[-1], config.collision_margin, config.collision_scale)
        scale = {"collision": min(max((progress - 0.15) / 0.25, 0.0), 1.0)}
        total = sum(
            (scale.get(name, 1.0) * getattr(config, f"{name}_weight") * value for name, value in row.items()),
            start=zero,
        )
        return total, row

    def _crowd(self) -> torch.Tensor:
        """Jittered hands, three quarters of them from those in which something nearly touches."""
        count = self.config.collisions if self.gaps is not None else 0
        active = self.crowded[self.hands.draw(len(self.crowded), 3 * count // 4)]
        hands = torch.cat([active, self.hands.recorded(count - len(active))])
        return hands + self.config.jitter * self.hands.normal(hands.shape)
