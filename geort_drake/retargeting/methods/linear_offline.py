"""Eq. 1 of the GeoRT paper, learned offline (Robotic Telekinesis, Sivakumar et al. 2022; table II of GeoRT).

The method trains the network of `geort` with another loss: each robot fingertip should be at the scaled
position of the person's fingertip relative to the wrist. The result depends strongly on the scale.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from geort_drake.retargeting.method import TrainedMethod, TrainingConfig, TrainingData, TrainingResult
from geort_drake.retargeting.numpy_retargeter import Retargeter

if TYPE_CHECKING:
    import torch

    from geort_drake.retargeting.training.descent import Report

SCALE = 1.6  # α, robot over human, from dex-retargeting's settings for the Allegro hand
REST_WEIGHT = 1e-3  # ε, weight of the regulariser
LENGTH_UNIT = 0.1  # m; unit of the vectors in the loss


@dataclass(frozen=True)
class LinearConfig(TrainingConfig):
    """Settings of `train_linear_offline`."""

    hidden: int = 128  # width of both hidden layers of each finger's network
    points: int = 256  # human fingertips per finger and step


def train_linear_offline(
    data: TrainingData,
    config: LinearConfig | None = None,
    seed: int = 0,
    device: str = "cpu",
    report: "Report | None" = None,
) -> TrainingResult:
    """Trains per-finger networks to minimise mean |α v_H − v_R|² + ε |(q − mid) / half range|².

    v are vectors from the wrist to the fingertips, in 0.1 m; q of the data is unused. See `TrainedMethod`.
    """
    import torch

    from geort_drake.retargeting.training.descent import descend, device_of, one_thread
    from geort_drake.retargeting.training.human_data import HumanData
    from geort_drake.retargeting.training.networks import RetargetingNetwork

    config = config or LinearConfig()
    config.validate()
    kinematics, to = data.kinematics, device_of(device)
    generator = torch.Generator().manual_seed(seed)
    human = HumanData(data.p_HF, kinematics.finger_names)
    clouds = [torch.tensor(cloud, dtype=torch.float32, device=to) for cloud in human.clouds]
    p_BW = torch.tensor(kinematics.p_BW, dtype=torch.float32, device=to)
    network = RetargetingNetwork(
        kinematics, torch.tensor(human.mean), torch.tensor(human.scale), config.hidden, generator
    ).to(to)

    def losses(_step: int) -> "tuple[torch.Tensor, dict[str, torch.Tensor]]":
        x = torch.stack(
            [cloud[torch.randint(len(cloud), (config.points,), generator=generator)] for cloud in clouds], 1
        )
        q = network(x)
        error = (SCALE * x - (kinematics.fingertips(q) - p_BW)) / LENGTH_UNIT
        matching = (error**2).sum(-1).mean()
        rest = (((q - network.centre) / network.half_range) ** 2).mean()
        return matching + REST_WEIGHT * rest, {"matching": matching, "rest": rest}

    with one_thread():
        descent = descend(network, losses, config.steps, config.learning_rate, report)
    return TrainingResult(
        network=network.cpu(),
        history=descent.history,
        timings={"training_s": descent.seconds},
        stopped_at=descent.stopped_at,
        human_points=human.points,
    )


METHODS = (
    TrainedMethod(
        "linear_offline",
        "a network trained on Eq. 1 of the paper (Robotic Telekinesis)",
        LinearConfig,
        train_linear_offline,
        Retargeter,
    ),
)
