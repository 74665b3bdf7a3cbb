"""Eq. 1 of the GeoRT paper, learned once (Robotic Telekinesis, Sivakumar et al. 2022; the paper's table II).

The network is GeoRT's, so that the two differ in what they learn alone: here, that each robot fingertip
is where the person's is, seen from the wrist and scaled. Everything hangs on the scale.
"""

import numpy as np
import torch

from geort_drake.retargeting.methods.geort import TrainingConfig, TrainingResult
from geort_drake.retargeting.training.descent import Report, descend, device_of, one_thread
from geort_drake.retargeting.training.human_data import HumanData
from geort_drake.retargeting.training.kinematics import HandKinematics
from geort_drake.retargeting.training.networks import RetargetingNetwork
from geort_drake.retargeting.training.pretraining import RobotSamples

SCALE = 1.6  # α, robot over human, as in dex-retargeting's settings of the Allegro hand
REST_WEIGHT = 1e-3  # of the regulariser, on joint angles in half ranges away from the middle


def train_linear_offline(
    p_HF: np.ndarray,
    kinematics: HandKinematics,
    robot_samples: RobotSamples | None = None,
    config: TrainingConfig | None = None,
    seed: int = 0,
    device: str = "cpu",
    report: Report | None = None,
) -> TrainingResult:
    """Trains per-finger networks to minimise mean |α v_H − v_R|² + ε |(q − mid) / half range|².

    v are the vectors from the wrist to each fingertip, in `length_unit`. Called as `train_geort` is;
    of its settings it uses steps, points, learning_rate, hidden, length_unit and human_voxel. Robot
    samples are not needed.

    Raises:
        TrainingError: on unusable input or settings, or when the loss is not finite from the start;
            see `descend` for later.
    """
    del robot_samples
    config = config or TrainingConfig()
    config.validate()
    with one_thread():
        return _train(p_HF, kinematics, config, seed, device_of(device), report)


def _train(
    p_HF: np.ndarray,
    kinematics: HandKinematics,
    config: TrainingConfig,
    seed: int,
    device: torch.device,
    report: Report | None,
) -> TrainingResult:
    generator = torch.Generator().manual_seed(seed)
    human = HumanData(p_HF, kinematics.finger_names, config.human_voxel)
    clouds = [torch.tensor(cloud, dtype=torch.float32, device=device) for cloud in human.clouds]
    p_BW = torch.tensor(kinematics.p_BW, dtype=torch.float32, device=device)
    network = RetargetingNetwork(
        kinematics, torch.tensor(human.mean), torch.tensor(human.scale), config.hidden, generator
    ).to(device)

    def losses(_step: int) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        x = torch.stack(
            [cloud[torch.randint(len(cloud), (config.points,), generator=generator)] for cloud in clouds], 1
        )
        q = network(x)
        error = (SCALE * x - (kinematics.fingertips(q) - p_BW)) / config.length_unit
        matching = (error**2).sum(-1).mean()
        rest = (((q - network.centre) / network.half_range) ** 2).mean()
        return matching + REST_WEIGHT * rest, {"matching": matching, "rest": rest}

    descent = descend(network, losses, config.steps, config.learning_rate, report)
    return TrainingResult(
        network=network.cpu(),
        history=descent.history,
        timings={"training_s": descent.seconds},
        stopped_at=descent.stopped_at,
        human_points=human.points,
    )
