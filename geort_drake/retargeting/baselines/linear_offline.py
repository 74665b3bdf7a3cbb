"""Eq. 1 of the GeoRT paper, learned once (Robotic Telekinesis, Sivakumar et al. 2022; the paper's table II).

The network is GeoRT's, so that the two differ in what they learn alone: here, that each robot fingertip
is where the person's is, seen from the wrist and scaled. Everything hangs on the scale.
"""

import math
import time
from collections.abc import Callable

import numpy as np
import torch

from geort_drake.errors import TrainingError
from geort_drake.retargeting.baselines.online import ALLEGRO_WRIST
from geort_drake.retargeting.human_data import HumanData
from geort_drake.retargeting.kinematics import HandKinematics
from geort_drake.retargeting.networks import RetargetingNetwork
from geort_drake.retargeting.pretraining import RobotSamples
from geort_drake.retargeting.training import TrainingConfig, TrainingResult

SCALE = 1.6  # α, robot over human, as in dex-retargeting's settings of the Allegro hand
REST_WEIGHT = 1e-3  # of the regulariser, on joint angles in half ranges away from the middle


def train_linear_offline(
    p_HF: np.ndarray,
    kinematics: HandKinematics,
    robot_samples: RobotSamples | None = None,
    config: TrainingConfig | None = None,
    seed: int = 0,
    device: str = "cpu",
    report: Callable[[int, int, dict[str, float]], None] | None = None,
    collides_beyond_tips: Callable[[np.ndarray], np.ndarray] | None = None,
) -> TrainingResult:
    """Trains per-finger networks to minimise mean |α v_H − v_R|² + ε |(q − mid) / half range|².

    v are the vectors from the wrist to each fingertip, in `length_unit`. Called as `train_geort` is;
    of its settings it uses steps, points, learning_rate, hidden, length_unit and human_voxel. Robot
    samples and collision labels are not needed.

    Raises:
        TrainingError: on unusable input or settings, or when the loss stops being finite.
    """
    del robot_samples, collides_beyond_tips
    config = config or TrainingConfig()
    config.validate()
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as in `train_geort`: the products are small, and the sums keep their order
    try:
        return _train(p_HF, kinematics, config, seed, torch.device(device), report)
    finally:
        torch.set_num_threads(threads)


def _train(p_HF, kinematics, config, seed, device, report) -> TrainingResult:
    generator = torch.Generator().manual_seed(seed)
    human = HumanData(p_HF, kinematics.finger_names, config.human_voxel)
    clouds = [torch.tensor(cloud, dtype=torch.float32, device=device) for cloud in human.clouds]
    p_BW = torch.tensor(ALLEGRO_WRIST, dtype=torch.float32, device=device)
    network = RetargetingNetwork(
        kinematics, torch.tensor(human.mean), torch.tensor(human.scale), config.hidden, generator
    ).to(device)
    optimiser = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
    history: list[dict[str, float]] = []
    interval = max(config.steps // 100, 1)
    started = time.perf_counter()
    for step in range(config.steps):
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * 0.5 * (1.0 + math.cos(math.pi * step / config.steps))
        x = torch.stack(
            [cloud[torch.randint(len(cloud), (config.points,), generator=generator)] for cloud in clouds], 1
        )
        q = network(x)
        error = (SCALE * x - (kinematics.fingertips(q) - p_BW)) / config.length_unit
        matching = (error**2).sum(-1).mean()
        rest = (((q - network.centre) / network.half_range) ** 2).mean()
        total = matching + REST_WEIGHT * rest
        if not torch.isfinite(total):
            raise TrainingError(f"linear_offline: the loss stopped being finite at step {step}")
        optimiser.zero_grad(set_to_none=True)
        total.backward()
        optimiser.step()
        if step % interval == 0 or step == config.steps - 1:
            row = {name: float(value.detach()) for name, value in
                   (("total", total), ("matching", matching), ("rest", rest))}  # fmt: skip
            row = {"step": step, **row, "seconds": round(time.perf_counter() - started, 3)}
            history.append(row)
            if report is not None:
                report(step + 1, config.steps, row)
    return TrainingResult(
        network=network.cpu(),
        history=history,
        timings={"training_s": time.perf_counter() - started},
        human_points=human.points,
    )
