"""The network of `geort_coupled`: one per finger, and a small residual that sees all fingertips."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import nn

from geort_drake.errors import TrainingError
from geort_drake.retargeting.training.kinematics import HandKinematics
from geort_drake.retargeting.training.networks import RetargetingNetwork, StackedMlp


class CoupledNetwork(RetargetingNetwork):
    """q = centre + half_range · tanh(base_i(x_i) + residual(x_1, …, x_F)), x the normalised fingertips.

    The residual starts at zero, so the map starts as independent fingers.
    """

    stacked_centre: torch.Tensor
    stacked_half_range: torch.Tensor

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
        for name, values in (("centre", self.centre), ("half_range", self.half_range)):
            stacked = torch.zeros(outputs)
            stacked[self.columns] = values
            self.register_buffer(f"stacked_{name}", stacked.reshape(fingers, 1, -1))
        self.residual = StackedMlp(1, widths, generator)
        for parameters in (self.residual.weights, self.residual.biases):
            nn.init.zeros_(parameters[-1])

    def forward(self, p_HF: torch.Tensor) -> torch.Tensor:
        """Joint angles (N, n) in rad for human fingertips (N, F, 3) in m."""
        x = (p_HF.transpose(0, 1) - self.mean) / self.scale
        together = x.transpose(0, 1).reshape(1, len(p_HF), -1)
        y = self.mlp(x).transpose(0, 1).reshape(len(p_HF), -1) + self.residual(together)[0]
        if not self._in_order:
            y = y[:, self.columns]
        return self.centre + self.half_range * torch.tanh(y)

    def angles_by_finger(
        self, whole: torch.Tensor, own: torch.Tensor, some: slice = slice(None)
    ) -> torch.Tensor:
        """Joint angles by finger, (G, N + M, k) rad, as `HandKinematics.fingertips_by_finger` takes them.

        Args:
            whole: (N, F, 3) human fingertips in m of hands in which every one of the G fingers answers.
            own: (G, M, F, 3) of hands in which only finger G answers, which saves the others' networks.
            some: the G fingers; all by default.
        """
        groups, count, fingers, _ = own.shape
        row, number = torch.arange(groups), torch.arange(fingers)[some]
        mean, scale = self.mean[:, 0], self.scale[:, 0]
        x, x_own = (whole - mean) / scale, (own - mean) / scale
        together = torch.cat([x.flatten(1), x_own.reshape(groups * count, -1)])
        shared = self.residual(together[None])[0].reshape(len(together), fingers, -1)
        shared, shared_own = shared.split([len(whole), groups * count])
        shared_own = shared_own.reshape(groups, count, fingers, -1)[row, :, number]
        y = self.mlp(torch.cat([x[:, some].transpose(0, 1), x_own[row, :, number]], dim=1), some)
        y = y + torch.cat([shared[:, some].transpose(0, 1), shared_own], dim=1)
        return self.stacked_centre[some] + self.stacked_half_range[some] * torch.tanh(y)

    def in_order(self, angles: torch.Tensor) -> torch.Tensor:
        """Joint angles (N, n) in the order of q, from those of all fingers (F, N, k)."""
        stacked = angles.transpose(0, 1).flatten(1)
        return stacked if self._in_order else stacked[:, self.columns]

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays for `CoupledRetargeter`, in float64; the normalisation is folded into the first layers."""
        arrays = super().arrays()
        weights = [weight.detach().cpu().double().numpy()[0] for weight in self.residual.weights]
        biases = [bias.detach().cpu().double().numpy()[0, 0] for bias in self.residual.biases]
        weights[0] = weights[0] / self.scale.cpu().double().numpy().reshape(-1, 1)
        biases[0] = biases[0] - self.mean.cpu().double().numpy().reshape(-1) @ weights[0]
        for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
            arrays[f"residual_weight{number}"], arrays[f"residual_bias{number}"] = weight, bias
        return arrays

    def set_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Takes over the weights that `arrays` of an equal network returned.

        Raises:
            TrainingError: they are of layers of other shapes.
        """
        for name, own in self.arrays().items():
            if name not in arrays or arrays[name].shape != own.shape:
                given = arrays[name].shape if name in arrays else "missing"
                raise TrainingError(
                    f"weights to start from: {name} must be of shape {own.shape}, it is {given}"
                )
        values = {name: np.asarray(array, dtype=float) for name, array in arrays.items()}
        # Undoes the folding of `arrays`, with this network's own normalisation.
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
