"""By how much a map of `geort_coupled` is worse than it should be, measured while it is trained."""

import functools

import numpy as np
import torch
from torch import nn

from geort_drake.retargeting.kinematics import HandKinematics
from geort_drake.retargeting.map_figures import ROBOT_SAMPLES, coverage, cross_talk, robot_voxels

FRAMES = 10_000  # a longer recording is thinned
ANCHORS = 500  # hands per finger at which cross-talk is measured


class Shortfalls:
    """Relative errors of coverage and cross-talk over the whole recording, as an evaluation measures them."""

    def __init__(self, frames: torch.Tensor, kinematics: HandKinematics, config, seed: int):
        """Takes real frames (T, F, 3), m, and a `CoupledConfig`."""
        self._frames = frames[:: len(frames) // FRAMES + 1].cpu().numpy()
        self._kinematics, self._config, self._seed = kinematics, config, seed
        self._device = frames.device

    def __call__(self, network: nn.Module) -> dict[str, float]:
        """Of coverage, at 10 or 15 mm, whichever is the farther from what is wanted, and of cross-talk."""

        def g(p_HF: np.ndarray) -> np.ndarray:
            hands = torch.tensor(p_HF, dtype=torch.float32, device=self._device)
            return self._kinematics.fingertips(network(hands)).cpu().numpy()

        config = self._config
        with torch.no_grad():
            reached = coverage(self._voxels, list(np.moveaxis(g(self._frames), 1, 0)))
            talk = cross_talk(g, self._frames, np.random.default_rng(self._seed), ANCHORS)
        near = (1.0 - reached["10mm"]) / (1.0 - config.coverage_wanted)
        far = (1.0 - reached["15mm"]) / (1.0 - config.far_coverage_wanted)
        return {"coverage": max(near, far) - 1.0, "cross_talk": talk / config.cross_talk_wanted - 1.0}

    @functools.cached_property
    def _voxels(self) -> list[np.ndarray]:
        """Per finger, the centres of its C-space's voxels, m."""
        hand = self._kinematics
        rng = np.random.default_rng(self._seed)
        q = rng.uniform(hand.lower, hand.upper, (ROBOT_SAMPLES, len(hand.joint_names)))
        tips = hand.fingertips(torch.tensor(q, dtype=torch.float32, device=self._device))
        return robot_voxels(tips.cpu().numpy())
