"""Eq. 1 of the GeoRT paper, learned offline (Robotic Telekinesis, Sivakumar et al. 2022; table II of GeoRT).

The method trains the network of `geort` with another loss: each robot fingertip should be at the scaled
position of the person's fingertip relative to the wrist. The result depends strongly on the scale.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from geort_drake.retargeting.base import kinematics_of
from geort_drake.retargeting.clouds import voxel_thinned
from geort_drake.retargeting.descent import Losses, Report, device_of, minimise, one_thread
from geort_drake.retargeting.geort import HUMAN_VOXEL, RetargetingModel
from geort_drake.retargeting.kinematics import fingertips
from geort_drake.retargeting.mlp import MlpRetargeter
from geort_drake.retargeting.online import SCALE

REST_WEIGHT = 1e-3  # ε, weight of the regulariser
LENGTH_UNIT = 0.1  # m; unit of the vectors in the loss


@dataclass(frozen=True)
class TelekinesisConfig:
    """Settings of `telekinesis`."""

    steps: int = 5000  # gradient steps
    learning_rate: float = 5e-3  # of Adam; falls to zero along half a cosine
    hidden: int = 128  # width of both hidden layers of each finger's network
    points: int = 256  # human fingertips per finger and step


def fit(
    hand: Any,
    p_HF: np.ndarray,
    seed: int = 0,
    config: TelekinesisConfig | None = None,
    device: str = "cpu",
    report: Report | None = None,
) -> MlpRetargeter:
    """Trains per-finger networks to minimise mean |α v_H − v_R|² + ε |(q − mid) / half range|².

    v are vectors from the wrist to the fingertips, in 0.1 m. See `Method.fit`.
    """
    config, kinematics, dev = config or TelekinesisConfig(), kinematics_of(hand), device_of(device)
    generator = torch.Generator().manual_seed(seed)
    human = [voxel_thinned(p_HF[:, i], HUMAN_VOXEL) for i in range(p_HF.shape[1])]
    clouds = [torch.tensor(cloud, dtype=torch.float32, device=dev) for cloud in human]
    p_BW = torch.tensor(kinematics.p_BW, dtype=torch.float32, device=dev)
    network = RetargetingModel(kinematics, human, config.hidden, generator).to(dev)

    def losses() -> Losses:
        x = torch.stack(
            [cloud[torch.randint(len(cloud), (config.points,), generator=generator)] for cloud in clouds], 1
        )
        q = network(x)
        error = (SCALE * x - (fingertips(kinematics, q) - p_BW)) / LENGTH_UNIT
        rest = ((q - network.centre) / network.half_range).square().mean()
        return {"matching": (1.0, error.square().sum(-1).mean()), "rest": (REST_WEIGHT, rest)}

    with one_thread():
        history = minimise(network, losses, config.steps, config.learning_rate, report)
    return network.retargeter(hand, history)
