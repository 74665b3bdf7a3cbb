"""The network of the universal map in torch; `person.UniversalRetargeter` is the same in NumPy."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import nn
from torch.nn.functional import silu

from geort_drake.errors import TrainingError
from geort_drake.hands.kinematics import HandKinematics
from geort_drake.retargeting.universal.person import MAX_DEVIATION, PAIR_UNIT


class UniversalNetwork(nn.Module):
    """q = centre + half_range · tanh(base_i(x_i) + residual(x_1, …, x_F, d_1, …, d_P)) for a person's hands.

    x_i is fingertip i relative to its knuckle, over the finger's length, transformed by an affine map of the
    person. d_j are the differences between the thumb's tip and the others, not scaled with the hand, so that
    contact looks the same for hands of all sizes. A small network computes this affine map, and gains and
    offsets of the hidden units, from the shape of the hand. All of these precede an activation, so they fold
    into the weights of an ordinary map; see `UniversalRetargeter.for_person`.
    """

    shape_mean: torch.Tensor
    shape_deviation: torch.Tensor
    input_mean: torch.Tensor
    input_scale: torch.Tensor
    centre: torch.Tensor
    half_range: torch.Tensor

    def __init__(
        self,
        kinematics: HandKinematics,
        shapes: torch.Tensor,
        p_HF: torch.Tensor,
        pairs: Sequence[tuple[int, int]],
        widths: tuple[int, int, int],
        generator: torch.Generator,
    ):
        """Normalises the inputs by the statistics of the training's people.

        Args:
            kinematics: kinematics of the robot hand.
            shapes: (N, 4F) shapes of people's hands, m; see `person.hand_shape`.
            p_HF: (N, T, F, 3) their fingertips, m.
            pairs: pairs of finger numbers that pinch.
            widths: of the hidden layers of a finger, of the residual, and of those that process the shape.
            generator: draws the initial weights.
        """
        super().__init__()
        F = len(kinematics.fingers)
        k = max(len(finger.joint_names) for finger in kinematics.fingers)
        self.columns = [0] * len(kinematics.joint_names)
        for number, finger in enumerate(kinematics.fingers):
            for i, joint in enumerate(finger.joint_indices):
                self.columns[joint] = number * k + i
        self._first, self._second = (list(side) for side in zip(*pairs, strict=True))
        x = relative_to_knuckles(p_HF, shapes).flatten(0, 1)
        constants = {
            "shape_mean": shapes.mean(0),
            "shape_deviation": shapes.std(0) + 1e-6,
            "input_mean": x.mean(0),
            "input_scale": x.std(0),
            "centre": torch.tensor(0.5 * (kinematics.upper + kinematics.lower)).float(),
            "half_range": torch.tensor(0.5 * (kinematics.upper - kinematics.lower)).float(),
        }
        for name, value in constants.items():
            self.register_buffer(name, value)

        def normal(*shape: int) -> nn.Parameter:
            return nn.Parameter(torch.randn(shape, generator=generator) / math.sqrt(shape[-2]))

        def zeros(*shape: int) -> nn.Parameter:
            return nn.Parameter(torch.zeros(shape))

        h, r, m = widths
        inputs = 3 * F + 3 * len(pairs)
        self.weights = nn.ParameterList([normal(F, 3, h), normal(F, h, h), normal(F, h, k)])
        self.biases = nn.ParameterList([zeros(F, 1, h), zeros(F, 1, h), zeros(F, 1, k)])
        self.residual_weights = nn.ParameterList([normal(inputs, r), normal(r, r), zeros(r, F * k)])
        self.residual_biases = nn.ParameterList([zeros(1, r), zeros(1, r), zeros(1, F * k)])
        self.shape_weights = nn.ParameterList([normal(4 * F, m), normal(m, m)])
        self.shape_biases = nn.ParameterList([zeros(1, m), zeros(1, m)])
        # The affine map of the inputs; gain and offset of layers 0 and 1; gain and offset of the residual.
        self.person_weights = nn.ParameterList([zeros(m, 12 * F), zeros(4 * F, m, h), zeros(2, m, r)])
        self.person_biases = nn.ParameterList([zeros(1, 12 * F), zeros(4 * F, 1, h), zeros(2, 1, r)])

    def groups(self, weight_decay: float) -> list[dict]:
        """Returns parameter groups for an optimiser; parts that see combinations decay faster."""
        of_fingers = [*self.weights, *self.biases]
        shared = [
            parameter for parameter in self.parameters() if all(parameter is not one for one in of_fingers)
        ]
        return [
            {"params": of_fingers, "weight_decay": weight_decay},
            {"params": shared, "weight_decay": 3.0 * weight_decay},
        ]

    def forward(self, p_HF: torch.Tensor, shapes: torch.Tensor) -> torch.Tensor:
        """Computes joint angles (G, N, n), rad, for fingertips (G, N, F, 3), m, and shapes (G, 4F), m."""
        G, N, F, _ = p_HF.shape
        z = ((shapes - self.shape_mean) / self.shape_deviation).clamp(-MAX_DEVIATION, MAX_DEVIATION)
        for weight, bias in zip(self.shape_weights, self.shape_biases, strict=True):
            z = silu(torch.addmm(bias, z, weight))
        affine, modulation, shared = (
            z @ weight + bias for weight, bias in zip(self.person_weights, self.person_biases, strict=True)
        )
        A, b = affine.split([9 * F, 3 * F], dim=-1)
        modulation = modulation.reshape(4, F, G, 1, -1)
        x = (relative_to_knuckles(p_HF, shapes) - self.input_mean) / self.input_scale
        # Fingers first: (F, G, N, ·).
        x = x.permute(2, 0, 1, 3)
        x = x + x @ A.reshape(G, F, 3, 3).transpose(0, 1) + b.reshape(G, F, 1, 3).transpose(0, 1)
        y = x.reshape(F, G * N, 3)
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            y = torch.baddbmm(bias, y, weight)
            if layer < 2:
                gain, offset = modulation[2 * layer], modulation[2 * layer + 1]
                y = silu(torch.addcmul(offset, y.reshape(F, G, N, -1), 1.0 + gain)).reshape(F, G * N, -1)
        d = (p_HF[:, :, self._first] - p_HF[:, :, self._second]) / PAIR_UNIT
        u = torch.cat([x.permute(1, 2, 0, 3).flatten(2), d.flatten(2)], dim=-1)
        weights, biases = self.residual_weights, self.residual_biases
        u = torch.addmm(biases[0], u.flatten(0, 1), weights[0]).reshape(G, N, -1)
        u = silu(torch.addcmul(shared[1][:, None], u, 1.0 + shared[0][:, None]))
        u = silu(torch.addmm(biases[1], u.flatten(0, 1), weights[1]))
        u = torch.addmm(biases[2], u, weights[2])
        y = y.transpose(0, 1).reshape(G * N, -1) + u
        q = self.centre + self.half_range * torch.tanh(y[:, self.columns])
        return q.reshape(G, N, -1)

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns the weights for `UniversalRetargeter`, float32."""
        arrays = {name: value.detach().cpu().float().numpy() for name, value in self._tensors().items()}
        return arrays | {"columns": np.array(self.columns, dtype=np.int64)}

    @torch.no_grad()
    def set_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Sets the weights to the `arrays` of an equal network.

        Raises:
            TrainingError: an array is missing or has another shape.
        """
        for name, value in self._tensors().items():
            if name not in arrays or arrays[name].shape != value.shape:
                shape = arrays[name].shape if name in arrays else "missing"
                raise TrainingError(
                    f"the map to start from: {name} must be {tuple(value.shape)}, it is {shape}"
                )
            value.copy_(torch.as_tensor(arrays[name]))

    def _tensors(self) -> dict[str, torch.Tensor]:
        """Views of the weights and constants, by the names of arrays."""
        tensors: dict[str, torch.Tensor] = {
            name: getattr(self, name)
            for name in ("shape_mean", "shape_deviation", "input_mean", "input_scale")
        }
        F = len(self.weights[0])
        for number in range(3):
            tensors[f"weight{number}"], tensors[f"bias{number}"] = self.weights[number], self.biases[number]
            tensors[f"residual_weight{number}"] = self.residual_weights[number]
            tensors[f"residual_bias{number}"] = self.residual_biases[number][0]
        for number in range(2):
            tensors[f"shape_weight{number}"] = self.shape_weights[number]
            tensors[f"shape_bias{number}"] = self.shape_biases[number][0]
        affine, modulation, shared = self.person_weights
        affine_bias, modulation_bias, shared_bias = self.person_biases
        tensors["input_weight"], tensors["input_bias"] = affine, affine_bias[0]
        tensors["modulation_weight"] = modulation.unflatten(0, (4, F))
        tensors["modulation_bias"] = modulation_bias[:, 0].unflatten(0, (4, F))
        tensors["residual_modulation_weight"], tensors["residual_modulation_bias"] = shared, shared_bias[:, 0]
        return tensors


def relative_to_knuckles(p_HF: torch.Tensor, shapes: torch.Tensor) -> torch.Tensor:
    """Returns fingertips (G, N, F, 3), m, relative to knuckles, over finger lengths, from shapes (G, 4F)."""
    F = p_HF.shape[2]
    knuckles, lengths = shapes[:, None, : 3 * F], shapes[:, None, 3 * F :]
    return (p_HF - knuckles.unflatten(-1, (F, 3))) / lengths[..., None]
