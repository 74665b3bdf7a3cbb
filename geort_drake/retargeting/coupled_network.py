"""The network of `geort_coupled`: one per finger, and a small residual that sees all fingertips."""

import numpy as np
import torch
from torch import nn

from geort_drake.retargeting.kinematics import HandKinematics
from geort_drake.retargeting.networks import RetargetingNetwork, StackedMlp


class CoupledNetwork(RetargetingNetwork):
    """q = centre + half_range · tanh(base_i(x_i) + residual(x_1, …, x_F)), x the normalised fingertips.

    The residual starts at zero, so the map starts as independent fingers.
    """

    def __init__(
        self,
        kinematics: HandKinematics,
        mean: torch.Tensor,
        scale: torch.Tensor,
        hidden: int,
        residual_hidden: int,
        generator: torch.Generator,
    ):
        """`mean` (F, 3) and `scale` (F, 3) normalise the inputs, in m; the others are widths of layers."""
        super().__init__(kinematics, mean, scale, hidden, generator)
        fingers = len(kinematics.fingers)
        outputs = fingers * self.mlp.weights[-1].shape[2]
        widths = (3 * fingers, residual_hidden, residual_hidden, outputs)
        self.residual = StackedMlp(1, widths, generator)
        for parameters in (self.residual.weights, self.residual.biases):
            nn.init.zeros_(parameters[-1])

    def forward(self, p_HF: torch.Tensor) -> torch.Tensor:
        """Joint angles (N, n) in rad for human fingertips (N, F, 3) in m."""
        x = self._normalised(p_HF)
        return self._angles(self.mlp(x).transpose(0, 1).reshape(len(p_HF), -1), x)

    def of_finger(self, number: int, p_HF: torch.Tensor) -> torch.Tensor:
        """The same, but only one finger's joints are right: at half the cost."""
        x, own = self._normalised(p_HF), slice(number, number + 1)
        return self._angles(self.mlp(x[own], own)[0].repeat(1, len(x)), x)

    def _normalised(self, p_HF: torch.Tensor) -> torch.Tensor:
        return (p_HF.transpose(0, 1) - self.mean) / self.scale

    def _angles(self, y: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
        y = y + self.residual(x.transpose(0, 1).reshape(1, len(y), -1))[0]
        if not self._in_order:
            y = y[:, self.columns]
        return self.centre + self.half_range * torch.tanh(y)

    def arrays(self) -> dict[str, np.ndarray]:
        """What `CoupledRetargeter` is made of, in float64: the normalisation is folded into the layers 0."""
        arrays = super().arrays()
        weights = [weight.detach().cpu().double().numpy()[0] for weight in self.residual.weights]
        biases = [bias.detach().cpu().double().numpy()[0, 0] for bias in self.residual.biases]
        weights[0] = weights[0] / self.scale.cpu().double().numpy().reshape(-1, 1)
        biases[0] = biases[0] - self.mean.cpu().double().numpy().reshape(-1) @ weights[0]
        for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
            arrays[f"residual_weight{number}"], arrays[f"residual_bias{number}"] = weight, bias
        return arrays
