"""GeoRT (Yin et al. 2025, "Geometric Retargeting"): Algorithm 1 of the paper, with its weights.

Names are the paper's: f is the retargeting model, FK the forward kinematics of the fingertips, C the
collision classifier, x_H a human gesture, d a small step. Lengths are in metres, for which the paper's ranges
of the weights hold. What the paper leaves open is chosen here: two hidden layers of SiLU units, σ = 4 mm, and
voxels of 1 and 3 mm that make samples of the human and the robot clouds uniform in space.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn.functional import binary_cross_entropy_with_logits, cosine_similarity, silu, softplus

from geort_drake.errors import UnknownNameError
from geort_drake.hands.kinematics import HandKinematics
from geort_drake.retargeting.base import interface_of, kinematics_of
from geort_drake.retargeting.clouds import voxel_thinned
from geort_drake.retargeting.descent import Losses, Report, device_of, minimise, one_thread
from geort_drake.retargeting.kinematics import constant, fingertips
from geort_drake.retargeting.mlp import MlpRetargeter, output_columns

Tensor = torch.Tensor
FORWARD_KINEMATICS = ("neural", "exact")
HUMAN_VOXEL, ROBOT_VOXEL = 0.001, 0.003  # m


@dataclass(frozen=True)
class GeortConfig:
    """Settings of `geort`. The weights λ1 to λ4 lie in the paper's ranges, for lengths in metres."""

    cover_weight: float = 100.0  # λ1, from 10 to 100
    flat_weight: float = 1.0  # λ2
    pinch_weight: float = 1e3  # λ3, from 10³ to 10⁶
    collision_weight: float = 1e-2  # λ4, from 10⁻⁴ to 10⁻²
    pinch_distance: float = 0.01  # the paper's d, m; fingertips closer than this pinch
    step: float = 0.004  # σ, m; deviation of each coordinate of d in criteria I and III
    steps: int = 3000  # N_train
    learning_rate: float = 5e-3  # of Adam; falls to zero along half a cosine
    hidden: int = 128  # width of both hidden layers of every network
    gestures: int = 256  # human gestures per step
    points: int = 256  # points of each cloud per step
    robot_samples: int = 100_000  # random joint positions of the robot
    fk: str = "neural"  # or "exact", the analytical forward kinematics that the paper mentions
    pretraining_steps: int = 3000  # of the training of FK, and of C
    pretraining_batch: int = 512  # robot samples per step of these


class FingerMlps(nn.Module):
    """F independent MLPs of equal shape, evaluated as a batch: (F, N, a) → (F, N, b)."""

    def __init__(self, count: int, widths: Sequence[int], generator: torch.Generator):
        super().__init__()
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for a, b in itertools.pairwise(widths):
            bound = 1.0 / math.sqrt(a)
            for parameters, shape in ((self.weights, (count, a, b)), (self.biases, (count, 1, b))):
                parameters.append(torch.empty(shape).uniform_(-bound, bound, generator=generator))

    def forward(self, x: Tensor) -> Tensor:
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = silu(torch.baddbmm(bias, x, weight))
        return torch.baddbmm(self.biases[-1], x, self.weights[-1])


class RetargetingModel(nn.Module):
    """f(x_H) = [f_1(x_H^1), …, f_F(x_H^F)], each f_i an MLP with tanh that spans the joints' ranges."""

    def __init__(
        self, hand: HandKinematics, clouds: Sequence[np.ndarray], hidden: int, generator: torch.Generator
    ):
        super().__init__()
        widest = max(len(finger.joint_names) for finger in hand.fingers)
        self.mlps = FingerMlps(len(hand.fingers), (3, hidden, hidden, widest), generator)
        self.columns = output_columns(hand)
        self.mean = constant(np.stack([cloud.mean(0) for cloud in clouds])[:, None])
        self.scale = constant(np.maximum(np.stack([cloud.std(0) for cloud in clouds]), 1e-3)[:, None])
        self.centre = constant(0.5 * (hand.lower + hand.upper))
        self.half_range = constant(0.5 * (hand.upper - hand.lower))

    def forward(self, p_HF: Tensor) -> Tensor:
        """Computes joint angles (N, n), rad, of human fingertips (N, F, 3) in the wrist frame, m."""
        y = self.mlps((p_HF.transpose(0, 1) - self.mean) / self.scale)
        y = y.transpose(0, 1).reshape(len(p_HF), -1)[:, self.columns]
        return self.centre + self.half_range * torch.tanh(y)

    def retargeter(self, hand: Any, history: list[dict[str, float]]) -> MlpRetargeter:
        """Returns the map in NumPy, whose first layer includes the normalisation."""
        weights = [weight.detach().cpu().double().numpy() for weight in self.mlps.weights]
        biases = [bias.detach().cpu().double().numpy() for bias in self.mlps.biases]
        mean, scale = self.mean.cpu().double().numpy(), self.scale.cpu().double().numpy()
        weights[0] = weights[0] / scale.transpose(0, 2, 1)
        biases[0] = biases[0] - mean @ weights[0]
        layers = {f"weight{k}": weight for k, weight in enumerate(weights)}
        layers |= {f"bias{k}": bias for k, bias in enumerate(biases)}
        layers |= {"columns": np.array(self.columns)}
        retargeter = MlpRetargeter(*interface_of(hand), layers)
        retargeter.info = {"history": history}
        return retargeter


class NeuralKinematics(nn.Module):
    """FK_i of every finger, an MLP from its joint angles to its fingertip."""

    def __init__(self, hand: HandKinematics, p_BF: Tensor, hidden: int, generator: torch.Generator):
        """Normalises the outputs by samples p_BF (N, F, 3), m."""
        super().__init__()
        widest = max(len(finger.joint_names) for finger in hand.fingers)
        # A joint that a finger lacks reads joint 0 and counts zero.
        spare = [widest - len(finger.joint_indices) for finger in hand.fingers]
        self.indices = [[*f.joint_indices, *[0] * k] for f, k in zip(hand.fingers, spare, strict=True)]
        self.used = constant([[1.0] * (widest - k) + [0.0] * k for k in spare])
        self.centre = constant(0.5 * (hand.lower + hand.upper))
        self.half_range = constant(0.5 * (hand.upper - hand.lower))
        self.mean, self.scale = constant(p_BF.mean(0)[:, None].cpu()), constant(p_BF.std(0).mean().cpu())
        self.mlps = FingerMlps(len(hand.fingers), (widest, hidden, hidden, 3), generator)

    def forward(self, q: Tensor) -> Tensor:
        angles = ((q - self.centre) / self.half_range)[:, self.indices] * self.used
        return (self.mean + self.scale * self.mlps(angles.transpose(0, 1))).transpose(0, 1)


class CollisionClassifier(nn.Module):
    """The logit of C(q), the probability that the hand collides with itself at joint angles q."""

    def __init__(self, hand: HandKinematics, hidden: int, generator: torch.Generator):
        super().__init__()
        self.centre = constant(0.5 * (hand.lower + hand.upper))
        self.half_range = constant(0.5 * (hand.upper - hand.lower))
        self.mlp = FingerMlps(1, (len(hand.joint_names), hidden, hidden, 1), generator)

    def forward(self, q: Tensor) -> Tensor:
        return self.mlp(((q - self.centre) / self.half_range)[None])[0, :, 0]


def direction_loss(d: Tensor, motion: Tensor) -> Tensor:
    """Criterion I: −Σ_i E ⟨d/|d|, Δ/|Δ|⟩ of human steps d and robot motions Δ, (N, F, 3)."""
    return -cosine_similarity(d, motion, dim=-1, eps=1e-12).mean(0).sum()


def cover_loss(robot: Tensor, mapped: Tensor) -> Tensor:
    """Criterion II: Σ_i Chamfer(P_R^i, FK_i ∘ f_i(P_H^i)) of clouds (M, F, 3) and (N, F, 3), m²."""
    robot, mapped = robot.transpose(0, 1), mapped.transpose(0, 1)
    with torch.no_grad():
        distances = torch.cdist(robot, mapped)
        nearest = [distances.argmin(dim)[..., None].expand(-1, -1, 3) for dim in (2, 1)]
    # Only nearest points have a gradient; this takes a tenth of the time of a gradient through all distances.
    uncovered = (robot - mapped.gather(1, nearest[0])).square().sum(-1).mean(1)
    outside = (mapped - robot.gather(1, nearest[1])).square().sum(-1).mean(1)
    return (uncovered + outside).sum()


def flatness_loss(ahead: Tensor, here: Tensor, behind: Tensor) -> Tensor:
    """Criterion III: E |FK∘f(x + d) + FK∘f(x − d) − 2 FK∘f(x)|² of robot fingertips (N, F, 3), m²."""
    return (ahead + behind - 2.0 * here).square().sum((1, 2)).mean()


def pinch_loss(x_H: Tensor, x_R: Tensor, distance: float) -> Tensor:
    """Criterion IV: E Σ_{i≠j} 1(|x_H^i − x_H^j| < d) |x_R^i − x_R^j|² of fingertips (N, F, 3), m²."""
    i, j = torch.tensor(list(itertools.permutations(range(x_H.shape[1]), 2)), device=x_H.device).T
    pinching = (x_H[:, i] - x_H[:, j]).norm(dim=-1) < distance
    return (pinching * (x_R[:, i] - x_R[:, j]).square().sum(-1)).sum(1).mean()


def collision_loss(logits: Tensor) -> Tensor:
    """Criterion V: −E log(1 − C(f(x_H))), given the logits (N,) of C."""
    return softplus(logits).mean()


def fit(
    hand: Any,
    p_HF: np.ndarray,
    seed: int = 0,
    config: GeortConfig | None = None,
    device: str = "cpu",
    report: Report | None = None,
) -> MlpRetargeter:
    """Trains a map by Algorithm 1; see `Method.fit`. Equal seeds give equal weights on the same machine.

    Args:
        hand: model of the robot hand; `collides_beyond_tips` leaves out contacts between fingertips, which
            are pinches.
    """
    config, kinematics, dev = config or GeortConfig(), kinematics_of(hand), device_of(device)
    if config.fk not in FORWARD_KINEMATICS:
        raise UnknownNameError("forward kinematics", config.fk, FORWARD_KINEMATICS)
    generator = torch.Generator().manual_seed(seed)  # on the CPU, so that draws do not depend on the device

    def tensor(array: np.ndarray) -> Tensor:
        return torch.tensor(np.asarray(array), dtype=torch.float32, device=dev)

    def sample(data: Tensor, count: int) -> Tensor:
        return data[torch.randint(len(data), (count,), generator=generator).to(dev)]

    with one_thread():
        # Line 1: generate (q, x, c) in simulation to train FK and C.
        samples = hand.sample(config.robot_samples, seed)
        q, c = tensor(samples), tensor(hand.collides_beyond_tips(samples))
        x_R = fingertips(kinematics, q)
        FK: Callable[[Tensor], Tensor] = partial(fingertips, kinematics)
        if config.fk == "neural":
            FK = neural = NeuralKinematics(kinematics, x_R, config.hidden, generator).to(dev)
            pretrain(neural, lambda x, y: ((x - y) / neural.scale).square().mean(), q, x_R, config, generator)
        C = CollisionClassifier(kinematics, config.hidden, generator).to(dev)
        pretrain(C, binary_cross_entropy_with_logits, q, c, config, generator)

        # Line 2: point clouds of the fingertips' spaces.
        fingers = range(p_HF.shape[1])
        human = [voxel_thinned(p_HF[:, i], HUMAN_VOXEL) for i in fingers]
        KC_H = [tensor(cloud) for cloud in human]
        KC_R = [tensor(voxel_thinned(x_R[:, i].cpu().numpy(), ROBOT_VOXEL)) for i in fingers]

        # Lines 3 to 7.
        f = RetargetingModel(kinematics, human, config.hidden, generator).to(dev)
        gestures = tensor(p_HF)

        def losses() -> Losses:
            x_H = sample(gestures, config.gestures)
            d = config.step * torch.randn(x_H.shape, generator=generator).to(dev)
            P_H, P_R = (
                torch.stack([sample(KC[i], config.points) for i in fingers], 1) for KC in (KC_H, KC_R)
            )
            # A single pass of all points is faster than one for each criterion.
            q = f(torch.cat([x_H, x_H + d, x_H - d, P_H]))
            here, ahead, behind, mapped = FK(q).split([len(x_H)] * 3 + [len(P_H)])
            return {
                "direction": (1.0, direction_loss(d, ahead - here)),
                "cover": (config.cover_weight, cover_loss(P_R, mapped)),
                "flat": (config.flat_weight, flatness_loss(ahead, here, behind)),
                "pinch": (config.pinch_weight, pinch_loss(x_H, here, config.pinch_distance)),
                "collision": (config.collision_weight, collision_loss(C(q[: len(x_H)]))),
            }

        history = minimise(f, losses, config.steps, config.learning_rate, report)
    return f.retargeter(hand, history)


def pretrain(
    model: nn.Module,
    loss: Callable,
    inputs: Tensor,
    labels: Tensor,
    config: GeortConfig,
    generator: torch.Generator,
) -> None:
    """Fits a model to labelled samples and freezes it."""

    def losses() -> Losses:
        rows = torch.randint(len(inputs), (config.pretraining_batch,), generator=generator).to(inputs.device)
        return {"fit": (1.0, loss(model(inputs[rows]), labels[rows]))}

    minimise(model, losses, config.pretraining_steps, config.learning_rate)
    model.requires_grad_(False)
