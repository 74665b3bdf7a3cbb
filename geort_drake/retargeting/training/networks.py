"""The networks of GeoRT: one per finger for retargeting and for kinematics, and one collision classifier.

Fingers are independent but evaluated as one batch: the weights of all fingers are stacked along a first axis.
Fingers with fewer joints than the longest one have unused outputs. Initial weights come from a given
torch.Generator, never from the global one.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import nn
from torch.nn.functional import silu

from geort_drake.retargeting.training.kinematics import HandKinematics


class StackedMlp(nn.Module):
    """F independent multilayer perceptrons of equal shape, evaluated as a batch: (F, N, a) → (F, N, b).

    SiLU follows each layer except the last.
    """

    def __init__(self, count: int, widths: Sequence[int], generator: torch.Generator):
        super().__init__()
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        for a, b in itertools.pairwise(widths):
            bound = 1.0 / math.sqrt(a)
            for parameters, shape in ((self.weights, (count, a, b)), (self.biases, (count, 1, b))):
                values = torch.empty(shape).uniform_(-bound, bound, generator=generator)
                parameters.append(nn.Parameter(values))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        last = len(self.weights) - 1
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = torch.baddbmm(bias, x, weight)
            if number < last:
                x = silu(x)
        return x


class RetargetingNetwork(nn.Module):
    """Independent per-finger maps from human fingertips to joint angles inside their limits.

    f_i: p_HF → centre + half_range · tanh(MLP_i((p − mean_i) / scale_i)), 3→hidden→hidden→n_i.
    """

    mean: torch.Tensor
    scale: torch.Tensor
    centre: torch.Tensor
    half_range: torch.Tensor

    def __init__(
        self,
        kinematics: HandKinematics,
        mean: torch.Tensor,
        scale: torch.Tensor,
        hidden: int,
        generator: torch.Generator,
    ):
        """`mean` (F, 3) and `scale` (F, 3) normalise the inputs, in m; `hidden` is both layers' width."""
        super().__init__()
        chains = kinematics.fingers
        widest = max(len(finger.joint_names) for finger in chains)
        self.mlp = StackedMlp(len(chains), (3, hidden, hidden, widest), generator)
        # Number of joint j of q among the F · widest outputs.
        column = {
            index: number * widest + k
            for number, finger in enumerate(chains)
            for k, index in enumerate(finger.joint_indices)
        }
        self.columns = [column[j] for j in range(len(kinematics.joint_names))]
        self._in_order = self.columns == list(range(len(chains) * widest))
        self.register_buffer("mean", mean[:, None, :].float())
        self.register_buffer("scale", scale[:, None, :].float())
        _register_joint_ranges(self, kinematics)

    def forward(self, p_HF: torch.Tensor) -> torch.Tensor:
        """Computes joint angles (N, n), rad, for human fingertips (N, F, 3), m."""
        x = (p_HF.transpose(0, 1) - self.mean) / self.scale
        y = self.mlp(x).transpose(0, 1).reshape(p_HF.shape[0], -1)
        if not self._in_order:
            y = y[:, self.columns]
        return self.centre + self.half_range * torch.tanh(y)

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns float64 arrays for `Retargeter`, with the input normalisation folded into layer 0."""
        weights = [weight.detach().cpu().double() for weight in self.mlp.weights]
        biases = [bias.detach().cpu().double() for bias in self.mlp.biases]
        # (x − mean) / scale · W + b = x · (W / scale) + (b − mean / scale · W)
        weights[0] = weights[0] / self.scale.cpu().double().transpose(1, 2)
        biases[0] = biases[0] - torch.bmm(self.mean.cpu().double(), weights[0])
        arrays = {"columns": np.array(self.columns, dtype=np.int64)}
        for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
            arrays[f"weight{number}"], arrays[f"bias{number}"] = weight.numpy(), bias.numpy()
        return arrays


class NeuralKinematics(nn.Module):
    """The paper's per-finger neural forward kinematics, with the same `fingertips` as `HandKinematics`."""

    indices: torch.Tensor
    used: torch.Tensor
    centre: torch.Tensor
    half_range: torch.Tensor
    mean: torch.Tensor
    scale: torch.Tensor

    def __init__(
        self, kinematics: HandKinematics, p_BF: torch.Tensor, hidden: int, generator: torch.Generator
    ):
        """Normalises the outputs by samples p_BF (N, F, 3), m."""
        super().__init__()
        chains = kinematics.fingers
        widest = max(len(finger.joint_names) for finger in chains)
        # A missing joint reads joint 0 and is multiplied by zero.
        indices = [list(f.joint_indices) + [0] * (widest - len(f.joint_indices)) for f in chains]
        used = [[1.0] * len(f.joint_indices) + [0.0] * (widest - len(f.joint_indices)) for f in chains]
        self.register_buffer("indices", torch.tensor(indices).reshape(-1))
        self.register_buffer("used", torch.tensor(used)[:, None, :])
        _register_joint_ranges(self, kinematics)
        self.register_buffer("mean", p_BF.mean(0)[:, None].float())
        self.register_buffer("scale", p_BF.std(0).mean(-1)[:, None, None].float())
        self.mlp = StackedMlp(len(chains), (widest, hidden, hidden, 3), generator)

    def fingertips(self, q: torch.Tensor) -> torch.Tensor:
        """Approximates fingertip points p_BF (N, F, 3), m, at joint angles q (N, n), rad."""
        fingers, _, widest = self.used.shape
        u = ((q - self.centre) / self.half_range).index_select(1, self.indices)
        x = u.reshape(-1, fingers, widest).transpose(0, 1) * self.used
        return (self.mean + self.scale * self.mlp(x)).transpose(0, 1)


class CollisionClassifier(nn.Module):
    """Predicts the logit of the probability that the hand collides at joint angles."""

    centre: torch.Tensor
    half_range: torch.Tensor

    def __init__(self, kinematics: HandKinematics, hidden: int, generator: torch.Generator):
        super().__init__()
        _register_joint_ranges(self, kinematics)
        self.mlp = StackedMlp(1, (len(kinematics.joint_names), hidden, hidden, 1), generator)

    def forward(self, q: torch.Tensor) -> torch.Tensor:
        """Computes logits (N,) for joint angles q (N, n), rad."""
        return self.mlp(((q - self.centre) / self.half_range)[None])[0, :, 0]


def _register_joint_ranges(module: nn.Module, kinematics: HandKinematics) -> None:
    """Registers buffers `centre` and `half_range` (n,) of the joint limits, rad."""
    lower, upper = torch.tensor(kinematics.lower), torch.tensor(kinematics.upper)
    module.register_buffer("centre", (0.5 * (lower + upper)).float())
    module.register_buffer("half_range", (0.5 * (upper - lower)).float())
