"""Measures how far a map of `geort_coupled` is from its targets while it is trained."""

import functools
import math

import numpy as np
import torch
from torch import nn

from geort_drake.people.recording import PINCH_M
from geort_drake.retargeting.methods.coupled.config import CoupledConfig
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

COVERAGE_TARGET, FAR_COVERAGE_TARGET = 0.785, 0.945  # at 10 and 15 mm
FRAMES = 10_000  # a longer recording is thinned
MOTION_ANCHORS = 2000  # hands per finger at which motion preservation is measured
CROSS_TALK_ANCHORS = 1000  # the same for cross-talk


class ConstraintViolations:
    """Relative violations of the targets of coverage, cross-talk and pinches, on a whole recording.

    Motion has priority: the violation of coverage is negative where motion preservation is below its target.
    """

    def __init__(self, hands: TrainingHands, kinematics: HandKinematics, config: CoupledConfig, seed: int):
        """Takes the hands of a recording."""
        self._frames = hands.frames[:: len(hands.frames) // FRAMES + 1].numpy()
        self._pairs = np.array(hands.pairs)
        self._kinematics, self._config, self._seed = kinematics, config, seed

    def __call__(self, network: nn.Module) -> dict[str, float]:
        """Violations by name of the loss, positive where a target is missed; NaN if nothing pinches."""

        def g(p_HF: np.ndarray) -> np.ndarray:
            hands = torch.tensor(p_HF, dtype=torch.float32)
            return self._kinematics.fingertips(network(hands)).numpy()

        config, frames, rng = self._config, self._frames, np.random.default_rng(self._seed)
        with torch.no_grad():
            p_BF = g(frames)
            reached = coverage(self._voxels, list(np.moveaxis(p_BF, 1, 0)))
            other_motion = cross_talk(g, frames, rng, CROSS_TALK_ANCHORS)
            motions = [
                motion_preservation(g, frames, rng, MOTION_ANCHORS),
                motion_preservation_track(frames, p_BF),
            ]
        near = (1.0 - reached["10mm"]) / (1.0 - COVERAGE_TARGET)
        far = (1.0 - reached["15mm"]) / (1.0 - FAR_COVERAGE_TARGET)
        motion = (1.0 - min(value for value in motions if value is not None)) / (1.0 - config.motion_target)
        return {
            "coverage": min(max(near, far) - 1.0, 1.0 - motion),
            "cross_talk": other_motion / config.cross_talk_target - 1.0,
            "pinch": self._open_pinches(p_BF) / (1.0 - config.closed_target) - 1.0,
        }

    def _open_pinches(self, p_BF: np.ndarray) -> float:
        """The fraction of pinches in which the robot's fingertips (T, F, 3), m, do not meet."""
        first, second = self._pairs.T
        human, robot = (
            np.linalg.norm(tips[:, first] - tips[:, second], axis=-1) for tips in (self._frames, p_BF)
        )
        pinched = pinched_distances(human, robot, PINCH_M)
        return float((pinched > 2 * self._kinematics.tip_radius).mean()) if len(pinched) else math.nan

    @functools.cached_property
    def _voxels(self) -> list[np.ndarray]:
        """Per finger, the centres of its C-space's voxels, m."""
        hand = self._kinematics
        rng = np.random.default_rng(self._seed)
        q = rng.uniform(hand.lower, hand.upper, (ROBOT_SAMPLES, len(hand.joint_names)))
        tips = hand.fingertips(torch.tensor(q, dtype=torch.float32))
        return robot_voxels(tips.numpy())
