"""The network of the universal map in torch; `person.UniversalRetargeter` is the same in NumPy."""

import math
from collections.abc import Mapping

import numpy as np
import torch
from torch import nn
from torch.nn.functional import silu

from geort_drake.errors import TrainingError
from geort_drake.hands.kinematics import HandKinematics
from geort_drake.retargeting.base import shape_of, thumb_and_others
from geort_drake.retargeting.kinematics import constant
from geort_drake.retargeting.mlp import output_columns
from geort_drake.retargeting.universal.person import (
    MAX_DEVIATION,
    PAIR_UNIT,
    STATISTICS,
    WEIGHTS,
    sizes_of,
)

# The other weights are zero at first.
_RANDOM = {
    "weight0", "weight1", "weight2", "residual_weight0", "residual_weight1", "shape_weight0", "shape_weight1",
}  # fmt: skip


class UniversalNetwork(nn.Module):
    """q = centre + half_range · tanh(base_i(x_i) + residual(x_1, …, x_F, d_1, …, d_P)) for a person's hands.

    x_i is fingertip i relative to its knuckle, over the finger's length, transformed by an affine map of the
    person. d_j are the differences between the thumb's tip and the others, not scaled with the hand, so that
    contact looks the same for hands of all sizes. A small network computes this affine map, and gains and
    offsets of the hidden units, from the shape of the hand. All of these precede an activation, so they fold
    into the weights of an ordinary map; see `UniversalRetargeter.for_person`.
    """

    def __init__(
        self,
        kinematics: HandKinematics,
        shapes: torch.Tensor,
        p_HF: torch.Tensor,
        widths: tuple[int, int, int],
        generator: torch.Generator,
    ):
        """Normalises the inputs by the statistics of the training's people.

        Args:
            kinematics: kinematics of the robot hand.
            shapes: (N, 4F) shapes of people's hands, m; see `person.hand_shape`.
            p_HF: (N, T, F, 3) their fingertips, m.
            widths: of the hidden layers of a finger, of the residual, and of those that process the shape.
            generator: draws the initial weights.
        """
        super().__init__()
        F = len(kinematics.fingers)
        k = max(len(finger.joint_names) for finger in kinematics.fingers)
        self.columns = output_columns(kinematics)
        self._thumb, self._others = thumb_and_others(kinematics.finger_names)
        x = relative_to_knuckles(p_HF, shapes).flatten(0, 1)
        self.shape_mean, self.shape_deviation = constant(shapes.mean(0)), constant(shapes.std(0) + 1e-6)
        self.input_mean, self.input_scale = constant(x.mean(0)), constant(x.std(0))
        self.centre = constant(0.5 * (kinematics.upper + kinematics.lower))
        self.half_range = constant(0.5 * (kinematics.upper - kinematics.lower))

        h, r, m = widths
        sizes = sizes_of(F) | {"h": h, "k": k, "r": r, "m": m, "outputs": F * k}
        self.p = nn.ParameterDict()
        for name, axes in WEIGHTS.items():
            shape = [*shape_of(axes, sizes)]
            if "_bias" in name:  # in files, only the biases of fingers have an axis for the hands of a batch
                shape.insert(-1, 1)
            self.p[name] = torch.zeros(shape)
            if name in _RANDOM:
                self.p[name] = torch.randn(shape, generator=generator) / math.sqrt(shape[-2])

    def groups(self, weight_decay: float, shared_weight_decay: float) -> list[dict]:
        """Returns an optimiser's parameter groups: the fingers' networks, and parts that see combinations."""
        fingers = [value for name, value in self.p.items() if "_" not in name]
        shared = [value for name, value in self.p.items() if "_" in name]
        return [
            {"params": fingers, "weight_decay": weight_decay},
            {"params": shared, "weight_decay": shared_weight_decay},
        ]

    def forward(self, p_HF: torch.Tensor, shapes: torch.Tensor) -> torch.Tensor:
        """Computes joint angles (G, N, n), rad, for fingertips (G, N, F, 3), m, and shapes (G, 4F), m."""
        p, (G, N, F, _) = self.p, p_HF.shape
        z = ((shapes - self.shape_mean) / self.shape_deviation).clamp(-MAX_DEVIATION, MAX_DEVIATION)
        for k in range(2):
            z = silu(torch.addmm(p[f"shape_bias{k}"], z, p[f"shape_weight{k}"]))
        affine, modulation, shared = (
            z @ p[f"{part}_weight"] + p[f"{part}_bias"]
            for part in ("input", "modulation", "residual_modulation")
        )
        A, b = affine.split([9 * F, 3 * F], dim=-1)
        modulation = modulation[..., None, :]
        x = (relative_to_knuckles(p_HF, shapes) - self.input_mean) / self.input_scale
        # Fingers first: (F, G, N, ·).
        x = x.permute(2, 0, 1, 3)
        x = x + x @ A.reshape(G, F, 3, 3).transpose(0, 1) + b.reshape(G, F, 1, 3).transpose(0, 1)
        y = x.reshape(F, G * N, 3)
        for k in range(2):
            y = torch.baddbmm(p[f"bias{k}"], y, p[f"weight{k}"]).reshape(F, G, N, -1)
            gain, offset = modulation[2 * k], modulation[2 * k + 1]
            y = silu(torch.addcmul(offset, y, 1.0 + gain)).reshape(F, G * N, -1)
        y = torch.baddbmm(p["bias2"], y, p["weight2"])
        d = (p_HF[:, :, [self._thumb]] - p_HF[:, :, self._others]) / PAIR_UNIT
        u = torch.cat([x.permute(1, 2, 0, 3).flatten(2), d.flatten(2)], dim=-1)
        u = torch.addmm(p["residual_bias0"], u.flatten(0, 1), p["residual_weight0"]).reshape(G, N, -1)
        u = silu(torch.addcmul(shared[1][:, None], u, 1.0 + shared[0][:, None]))
        u = silu(torch.addmm(p["residual_bias1"], u.flatten(0, 1), p["residual_weight1"]))
        u = torch.addmm(p["residual_bias2"], u, p["residual_weight2"])
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
            TrainingError: an array has another shape.
        """
        for name, value in self._tensors().items():
            if arrays[name].shape != value.shape:
                raise TrainingError(
                    f"the map to start from: {name} must be {tuple(value.shape)}, it is {arrays[name].shape}"
                )
            value.copy_(torch.as_tensor(arrays[name]))

    def _tensors(self) -> dict[str, torch.Tensor]:
        """Returns views of the constants and weights, in the shapes of files."""
        # In files, only the biases of fingers have an axis for the hands of a batch.
        weights = {name: value.squeeze(-2) if "_bias" in name else value for name, value in self.p.items()}
        return {name: getattr(self, name) for name in STATISTICS} | weights


def relative_to_knuckles(p_HF: torch.Tensor, shapes: torch.Tensor) -> torch.Tensor:
    """Returns fingertips (G, N, F, 3), m, relative to knuckles, over finger lengths, from shapes (G, 4F)."""
    F = p_HF.shape[2]
    knuckles, lengths = shapes[:, None, : 3 * F], shapes[:, None, 3 * F :]
    return (p_HF - knuckles.unflatten(-1, (F, 3))) / lengths[..., None]
