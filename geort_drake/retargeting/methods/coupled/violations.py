"""By how much a map of `geort_coupled` is worse than it should be, measured while it is trained."""

import functools
import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import nn

from geort_drake.retargeting.methods.coupled.hands import TrainingHands
from geort_drake.retargeting.training.kinematics import HandKinematics
from geort_drake.retargeting.training.map_figures import (
    ROBOT_SAMPLES,
    coverage,
    cross_talk,
    motion_preservation,
    motion_preservation_track,
    pinched_distances,
    robot_voxels,
)

if TYPE_CHECKING:
    from geort_drake.retargeting.methods.coupled.training import CoupledConfig

FRAMES = 10_000  # a longer recording is thinned
ANCHORS = 2000  # hands per finger at which motion preservation is measured
TALKING = 1000  # the same for cross-talk


class Shortfalls:
    """Relative errors of coverage, cross-talk and pinches on a whole recording, as an evaluation has them.

    Motion comes first: coverage is too high where motion preservation is too low.
    """

    def __init__(self, hands: TrainingHands, kinematics: HandKinematics, config: "CoupledConfig", seed: int):
        """Takes the hands of a recording."""
        self._frames = hands.frames[:: len(hands.frames) // FRAMES + 1].numpy()
        self._pairs = np.array(hands.pairs)
        self._kinematics, self._config, self._seed = kinematics, config, seed

    def __call__(self, network: nn.Module) -> dict[str, float]:
        """By the name of the loss, positive where coverage or closed pinches lack, or cross-talk is too much.

        NaN of what the recording does not show.
        """

        def g(p_HF: np.ndarray) -> np.ndarray:
            hands = torch.tensor(p_HF, dtype=torch.float32)
            return self._kinematics.fingertips(network(hands)).numpy()

        config, frames, rng = self._config, self._frames, np.random.default_rng(self._seed)
        with torch.no_grad():
            p_BF = g(frames)
            reached = coverage(self._voxels, list(np.moveaxis(p_BF, 1, 0)))
            talk = cross_talk(g, frames, rng, TALKING)
            motions = [motion_preservation(g, frames, rng, ANCHORS), motion_preservation_track(frames, p_BF)]
        near = (1.0 - reached["10mm"]) / (1.0 - config.coverage_wanted)
        far = (1.0 - reached["15mm"]) / (1.0 - config.far_coverage_wanted)
        motion = (1.0 - min(value for value in motions if value is not None)) / (1.0 - config.motion_wanted)
        return {
            "coverage": min(max(near, far) - 1.0, 1.0 - motion),
            "cross_talk": talk / config.cross_talk_wanted - 1.0,
            "pinch": self._open_pinches(p_BF) / (1.0 - config.closed_wanted) - 1.0,
        }

    def _open_pinches(self, p_BF: np.ndarray) -> float:
        """The share of pinches in which the robot's fingertips (T, F, 3), m, do not meet."""
        first, second = self._pairs.T
        human, robot = (
            np.linalg.norm(tips[:, first] - tips[:, second], axis=-1) for tips in (self._frames, p_BF)
        )
        pinched = pinched_distances(human, robot, self._config.pinch_threshold)
        return float((pinched > 2 * self._kinematics.tip_radius).mean()) if len(pinched) else math.nan

    @functools.cached_property
    def _voxels(self) -> list[np.ndarray]:
        """Per finger, the centres of its C-space's voxels, m."""
        hand = self._kinematics
        rng = np.random.default_rng(self._seed)
        q = rng.uniform(hand.lower, hand.upper, (ROBOT_SAMPLES, len(hand.joint_names)))
        tips = hand.fingertips(torch.tensor(q, dtype=torch.float32))
        return robot_voxels(tips.numpy())
