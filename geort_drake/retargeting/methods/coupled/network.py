"""The network of `geort_coupled`: one per finger, and a small residual that sees all fingertips."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import nn

from geort_drake.errors import TrainingError
from geort_drake.retargeting.training.kinematics import HandKinematics
from geort_drake.retargeting.training.networks import RetargetingNetwork, StackedMlp

HIDDEN, RESIDUAL_HIDDEN = 64, 128  # widths of hidden layers, also in the universal map


class CoupledNetwork(RetargetingNetwork):
    """q = centre + half_range · tanh(base_i(x_i) + residual(x_1, …, x_F)), x the normalised fingertips.

    The residual starts at zero, so the fingers start independent of each other.
    """

    def __init__(
        self, kinematics: HandKinematics, mean: torch.Tensor, scale: torch.Tensor, generator: torch.Generator
    ):
        """`mean` (F, 3) and `scale` (F, 3) normalise the inputs, in m."""
        super().__init__(kinematics, mean, scale, HIDDEN, generator)
        fingers = len(kinematics.fingers)
        outputs = fingers * self.mlp.weights[-1].shape[2]
        self.residual = StackedMlp(1, (3 * fingers, RESIDUAL_HIDDEN, RESIDUAL_HIDDEN, outputs), generator)
        for parameters in (self.residual.weights, self.residual.biases):
            nn.init.zeros_(parameters[-1])

    def groups(self, weight_decay: float) -> list[dict]:
        """Returns parameter groups for an optimiser; the residual, which sees combinations, decays faster."""
        return [
            {"params": [*self.mlp.parameters()], "weight_decay": weight_decay},
            {"params": [*self.residual.parameters()], "weight_decay": 3.0 * weight_decay},
        ]

    def forward(self, p_HF: torch.Tensor, codes: torch.Tensor | None = None) -> torch.Tensor:
        """Computes joint angles (..., n), rad, for human fingertips (..., F, 3), m; codes are ignored."""
        x = (p_HF.reshape(-1, *p_HF.shape[-2:]).transpose(0, 1) - self.mean) / self.scale
        together = x.transpose(0, 1).reshape(1, x.shape[1], -1)
        y = self.mlp(x).transpose(0, 1).reshape(x.shape[1], -1) + self.residual(together)[0]
        q = self.centre + self.half_range * torch.tanh(y[:, self.columns])
        return q.reshape(*p_HF.shape[:-2], -1)

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns float64 arrays for `CoupledRetargeter`; the first layers include the normalisation."""
        arrays = super().arrays()
        weights = [weight.detach().cpu().double().numpy()[0] for weight in self.residual.weights]
        biases = [bias.detach().cpu().double().numpy()[0, 0] for bias in self.residual.biases]
        weights[0] = weights[0] / self.scale.cpu().double().numpy().reshape(-1, 1)
        biases[0] = biases[0] - self.mean.cpu().double().numpy().reshape(-1) @ weights[0]
        for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
            arrays[f"residual_weight{number}"], arrays[f"residual_bias{number}"] = weight, bias
        return arrays

    def set_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Sets the weights to those that `arrays` of an equal network returned.

        Raises:
            TrainingError: an array is missing or has another shape.
        """
        for name, own in self.arrays().items():
            if name not in arrays or arrays[name].shape != own.shape:
                given = arrays[name].shape if name in arrays else "missing"
                raise TrainingError(
                    f"weights to start from: {name} must be of shape {own.shape}, it is {given}"
                )
        values = {name: np.asarray(array, dtype=float) for name, array in arrays.items()}
        # Undoes the folding of `arrays` for this network's normalisation.
        mean, scale = self.mean.double().cpu().numpy(), self.scale.double().cpu().numpy()
        W, R = values["weight0"], values["residual_weight0"]
        values["weight0"], values["bias0"] = W * scale.transpose(0, 2, 1), values["bias0"] + mean @ W
        values["residual_weight0"] = R * scale.reshape(-1, 1)
        values["residual_bias0"] = values["residual_bias0"] + mean.reshape(-1) @ R
        with torch.no_grad():
            for prefix, layers in (("", self.mlp), ("residual_", self.residual)):
                for kind, parameters in (("weight", layers.weights), ("bias", layers.biases)):
                    for number, parameter in enumerate(parameters):
                        value = values[f"{prefix}{kind}{number}"].reshape(parameter.shape)
                        parameter.copy_(torch.as_tensor(value))
