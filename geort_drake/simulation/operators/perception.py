"""Perception of the simulated person: noisy looks, their averages, and the sensed gain of the robot."""

import dataclasses as dc
import functools

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

from geort_drake.simulation.operators.config import OperatorConfig


@dc.dataclass(frozen=True)
class Seen:
    """The scene as the person sees it."""

    p_WF: np.ndarray  # (F, 3) robot fingertip points, m
    X_WB: RigidTransform  # robot hand base
    X_WO: RigidTransform  # object
    contact: np.ndarray  # (F,) force between each robot finger and the object, N

    @functools.cached_property
    def X_BW(self) -> RigidTransform:
        """Inverse of `X_WB`."""
        return self.X_WB.inverse()

    @functools.cached_property
    def p_BF(self) -> np.ndarray:
        """(F, 3) robot fingertip points in the hand base, m."""
        return self.X_BW.multiply(self.p_WF.T).T


def perceive(scene: Seen, config: OperatorConfig, rng: np.random.Generator) -> Seen:
    """The scene with noise on fingertips, poses and forces, drawn anew for each look."""
    num_fingers = len(scene.p_WF)
    noise = rng.normal(0, config.visual_noise, (num_fingers + 2, 3))
    turns = Rotation.from_rotvec(rng.normal(0, config.visual_turn_noise, (2, 3))).as_matrix()
    share = 1 + rng.normal(0, config.contact_noise, num_fingers)
    X_WO, X_WB = (
        RigidTransform(RotationMatrix(turn) @ X.rotation(), X.translation() + shift)
        for X, turn, shift in zip((scene.X_WO, scene.X_WB), turns, noise[-2:], strict=True)
    )
    # A felt force is never negative.
    return Seen(scene.p_WF + noise[:-2], X_WB, X_WO, scene.contact * np.maximum(share, 0))


def averaged(before: np.ndarray | None, now: np.ndarray, config: OperatorConfig) -> np.ndarray:
    """Running average over about `judging_time`; single looks are noisier than the tolerances.

    `before` is the average one period ago, None at the first look.
    """
    if before is None:
        return now
    return before + config.period / (config.period + config.judging_time) * (now - before)


@dc.dataclass(frozen=True)
class SensedGain:
    """The person's estimate of robot fingertip motion per own fingertip motion.

    People adapt to a new visuomotor gain within a few movements (Krakauer et al. 2000). The estimate is one
    number for the whole hand, Σ |Δrobot| |Δown| / Σ |Δown|², over free motions between looks at least
    `interval` apart. It starts at one.
    """

    # At the last look: time, own (F, 3) and robot's (F, 3) fingertips in their hands' frames.
    t: float = -np.inf
    own: np.ndarray | None = None
    robot: np.ndarray | None = None
    # The two sums, m².
    product: float = 1e-4
    square: float = 1e-4

    interval = 0.25  # s

    @property
    def ratio(self) -> float:
        """Robot motion over own motion."""
        return self.product / self.square

    def look(self, t: float, own: np.ndarray, robot: np.ndarray, free: np.ndarray) -> "SensedGain":
        """The estimate after a look at time t, s; fingers in contact are not `free` (F,)."""
        if t - self.t < self.interval:
            return self
        if self.own is None or self.robot is None:
            return dc.replace(self, t=t, own=own, robot=robot)
        own_step = np.linalg.norm(own - self.own, axis=1)
        robot_step = np.linalg.norm(robot - self.robot, axis=1)
        # Smaller motions are lost in the noise.
        use = free & (own_step > 0.005)
        return SensedGain(
            t,
            own,
            robot,
            self.product + float((own_step * robot_step)[use].sum()),
            self.square + float((own_step**2)[use].sum()),
        )
