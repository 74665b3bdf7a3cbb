"""The network of the universal map: one per finger and a residual, modulated by the code of a person."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import nn
from torch.nn.functional import silu

from geort_drake.retargeting.methods.coupled.network import HIDDEN, RESIDUAL_HIDDEN
from geort_drake.retargeting.training.kinematics import HandKinematics

MAX_DEVIATION = 3.0  # standard deviations to which the code is clamped
PAIR_SCALE = 0.05  # m; unit of the differences between the thumb's tip and the others
CODE_HIDDEN = 80  # width of the layers that process the code


def relative_to_knuckles(p_HF: torch.Tensor, codes: torch.Tensor) -> torch.Tensor:
    """Returns fingertips (G, N, F, 3), m, relative to knuckles, over finger lengths, both from `codes`."""
    F = p_HF.shape[2]
    knuckles, lengths = codes[:, None, : 3 * F], codes[:, None, 3 * F : 4 * F]
    return (p_HF - knuckles.unflatten(-1, (F, 3))) / lengths[..., None]


class UniversalNetwork(nn.Module):
    """q = centre + half_range · tanh(base_i(x_i) + residual(x_1, …, x_F, d_1, …, d_P)) for a person's hands.

    x_i is fingertip i relative to its knuckle, over the finger's length, transformed by an affine map of the
    person. d_j are the differences between the thumb's tip and the others, not scaled with the hand, so that
    contact looks the same for hands of all sizes. A small network computes this affine map, and gains and
    offsets of the hidden units, from the code. All of these precede an activation, so they fold into the
    weights of a `CoupledRetargeter`.
    """

    code_mean: torch.Tensor
    code_deviation: torch.Tensor
    input_mean: torch.Tensor
    input_scale: torch.Tensor
    centre: torch.Tensor
    half_range: torch.Tensor

    def __init__(
        self,
        kinematics: HandKinematics,
        codes: torch.Tensor,
        x: torch.Tensor,
        pairs: Sequence[tuple[int, int]],
        generator: torch.Generator,
    ):
        """Takes the statistics of the training's people.

        Args:
            kinematics: kinematics of the robot hand.
            codes: (N, C) codes of people.
            x: (N, F, 3) fingertips relative to their knuckles, over the fingers' lengths.
            pairs: pairs of finger numbers that pinch.
            generator: draws the initial weights.
        """
        super().__init__()
        F = self.fingers = len(kinematics.fingers)
        k = max(len(finger.joint_names) for finger in kinematics.fingers)
        self._pairs = pairs
        self.columns = [0] * len(kinematics.joint_names)
        for number, finger in enumerate(kinematics.fingers):
            for i, joint in enumerate(finger.joint_indices):
                self.columns[joint] = number * k + i
        constants = {
            "code_mean": codes.mean(0),
            "code_deviation": codes.std(0) + 1e-6,
            "centre": torch.tensor(0.5 * (kinematics.upper + kinematics.lower)).float(),
            "half_range": torch.tensor(0.5 * (kinematics.upper - kinematics.lower)).float(),
        }
        constants |= {"input_mean": x.mean(0), "input_scale": x.std(0)}
        for name, value in constants.items():
            self.register_buffer(name, value)

        def normal(*shape: int) -> nn.Parameter:
            return nn.Parameter(torch.randn(shape, generator=generator) / math.sqrt(shape[-2]))

        def zeros(*shape: int) -> nn.Parameter:
            return nn.Parameter(torch.zeros(shape))

        h, r, m = HIDDEN, RESIDUAL_HIDDEN, CODE_HIDDEN
        inputs = 3 * F + 3 * len(pairs)
        self.weights = nn.ParameterList([normal(F, 3, h), normal(F, h, h), normal(F, h, k)])
        self.biases = nn.ParameterList([zeros(F, 1, h), zeros(F, 1, h), zeros(F, 1, k)])
        self.residual_weights = nn.ParameterList([normal(1, inputs, r), normal(1, r, r), zeros(1, r, F * k)])
        self.residual_biases = nn.ParameterList([zeros(1, 1, r), zeros(1, 1, r), zeros(1, 1, F * k)])
        self.code_weights = nn.ParameterList([normal(1, codes.shape[1], m), normal(1, m, m)])
        self.code_biases = nn.ParameterList([zeros(1, 1, m), zeros(1, 1, m)])
        # The affine map of the inputs; gain, offset of layers 0 and 1; gain, offset of the residual.
        self.person_weights = nn.ParameterList([zeros(1, m, 12 * F), zeros(4 * F, m, h), zeros(2, m, r)])
        self.person_biases = nn.ParameterList([zeros(1, 1, 12 * F), zeros(4 * F, 1, h), zeros(2, 1, r)])

    def groups(self, weight_decay: float) -> list[dict]:
        """Returns parameter groups for an optimiser; parts that see combinations decay faster."""
        own = [*self.weights, *self.biases]
        shared = [parameter for parameter in self.parameters() if all(parameter is not one for one in own)]
        return [
            {"params": own, "weight_decay": weight_decay},
            {"params": shared, "weight_decay": 3.0 * weight_decay},
        ]

    def forward(self, p_HF: torch.Tensor, codes: torch.Tensor) -> torch.Tensor:
        """Computes joint angles (G, N, n), rad, for fingertips (G, N, F, 3), m, and people's codes (G, C)."""
        G, N, F, _ = p_HF.shape
        z = ((codes - self.code_mean) / self.code_deviation).clamp(-MAX_DEVIATION, MAX_DEVIATION)[None]
        for weight, bias in zip(self.code_weights, self.code_biases, strict=True):
            z = silu(torch.baddbmm(bias, z, weight))
        affine, modulation, shared = (
            z @ weight + bias for weight, bias in zip(self.person_weights, self.person_biases, strict=True)
        )
        A, b = affine[0].split([9 * F, 3 * F], dim=-1)
        modulation = modulation.reshape(4, F, G, 1, -1)
        x = (relative_to_knuckles(p_HF, codes) - self.input_mean) / self.input_scale
        x = x + torch.einsum("gnfi,gfij->gnfj", x, A.reshape(G, F, 3, 3)) + b.reshape(G, 1, F, 3)
        first, second = (list(side) for side in zip(*self._pairs, strict=True))
        d = (p_HF[:, :, first] - p_HF[:, :, second]) / PAIR_SCALE
        y = x.permute(2, 0, 1, 3).reshape(F, G * N, 3)
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            y = torch.baddbmm(bias, y, weight)
            if layer < 2:
                gain, offset = modulation[2 * layer], modulation[2 * layer + 1]
                y = silu(torch.addcmul(offset, y.reshape(F, G, N, -1), 1.0 + gain)).reshape(F, G * N, -1)
        y = y.reshape(F, G, N, -1).permute(1, 2, 0, 3).reshape(G, N, -1)
        u = torch.cat([x.flatten(2), d.flatten(2)], dim=-1)
        weights, biases = self.residual_weights, self.residual_biases
        u = u @ weights[0][0] + biases[0][0]
        u = silu(torch.addcmul(shared[1][:, None], u, 1.0 + shared[0][:, None]))
        u = silu(u @ weights[1][0] + biases[1][0])
        y = y + u @ weights[2][0] + biases[2][0]
        return self.centre + self.half_range * torch.tanh(y[..., self.columns])

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns the weights for `UniversalRetargeter`, in float32."""

        def array(tensor: torch.Tensor) -> np.ndarray:
            return tensor.detach().cpu().float().numpy()

        F = self.fingers
        arrays = {
            name: array(getattr(self, name))
            for name in ("code_mean", "code_deviation", "input_mean", "input_scale")
        }
        for number in (0, 1):
            arrays[f"code_weight{number}"] = array(self.code_weights[number][0])
            arrays[f"code_bias{number}"] = array(self.code_biases[number][0, 0])
        for number in (0, 1, 2):
            arrays[f"weight{number}"] = array(self.weights[number])
            arrays[f"bias{number}"] = array(self.biases[number])
            arrays[f"residual_weight{number}"] = array(self.residual_weights[number][0])
            arrays[f"residual_bias{number}"] = array(self.residual_biases[number][0, 0])
        affine, modulation, shared = self.person_weights
        arrays["input_weight"], arrays["input_bias"] = array(affine[0]), array(self.person_biases[0][0, 0])
        arrays["modulation_weight"] = array(modulation).reshape(4, F, *modulation.shape[1:])
        arrays["modulation_bias"] = array(self.person_biases[1][:, 0]).reshape(4, F, -1)
        arrays["residual_modulation_weight"] = array(shared)
        arrays["residual_modulation_bias"] = array(self.person_biases[2][:, 0])
        arrays["columns"] = np.array(self.columns, dtype=np.int64)
        return arrays
