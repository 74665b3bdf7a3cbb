"""Perception of the simulated person: errors of vision and touch, and the perceived gain of the robot."""

import dataclasses as dc
import functools
import math
from typing import NamedTuple

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.systems.port_values import rotation_of_vector

# The person looks ahead and down, along this direction in W.
GAZE_W = np.array([0.8, 0.0, -0.6])


@dc.dataclass(frozen=True)
class Seen:
    """The scene as the person sees it."""

    p_WF: np.ndarray  # (F, 3) robot fingertips, m
    X_WB: RigidTransform  # robot hand base
    X_WO: RigidTransform  # object
    contact: np.ndarray  # (F,) force between each robot finger and the object, N
    X_WP: RigidTransform | None = None  # where the object belongs

    @functools.cached_property
    def X_BW(self) -> RigidTransform:
        """Inverse of `X_WB`."""
        return self.X_WB.inverse()

    @functools.cached_property
    def p_BF(self) -> np.ndarray:
        """(F, 3) robot fingertips in the frame of the hand's base, m."""
        return self.X_BW.multiply(self.p_WF.T).T


class FreePlay(NamedTuple):
    """Free play that the person saw before the task: fingertips (T, F, 3), m, of each robot finger."""

    p_HF: np.ndarray  # own fingertips in H
    p_BF: np.ndarray  # robot fingertips in B
    period: float = 1 / 30  # s between two frames


@dc.dataclass(frozen=True)
class VisualError:
    """Present errors of vision."""

    p: np.ndarray  # (F + 1, 3) position errors of fingertips and hand relative to the object, in W, m
    turn: np.ndarray  # (2, 3) rotation errors of object and hand as rotation vectors, rad

    @classmethod
    def draw(cls, num_fingers: int, config: OperatorConfig, rng: np.random.Generator) -> "VisualError":
        """Returns independent errors of the configured sizes."""
        n = rng.normal(size=(num_fingers + 1, 3))
        across, along = config.visual_noise, config.visual_depth_noise
        p = across * n + (along - across) * (n.dot(GAZE_W)[:, None] * GAZE_W)
        return cls(p, rng.normal(0, config.visual_turn_noise, (2, 3)))

    def later(self, config: OperatorConfig, rng: np.random.Generator) -> "VisualError":
        """Returns the errors one period later."""
        kept = math.exp(-config.period / config.visual_noise_time) if config.visual_noise_time else 0.0
        new, weight = VisualError.draw(len(self.p) - 1, config, rng), math.sqrt(1 - kept**2)
        return VisualError(kept * self.p + weight * new.p, kept * self.turn + weight * new.turn)


def perceive(scene: Seen, error: VisualError, config: OperatorConfig, rng: np.random.Generator) -> Seen:
    """Returns the scene with errors of vision, and with new noise on forces at each call.

    Only positions relative to the object matter, so the object's own position has no error.
    """
    X_WB, X_WO, (turn_O, turn_B) = scene.X_WB, scene.X_WO, map(rotation_of_vector, error.turn)
    factor = 1 + rng.normal(0, config.contact_noise, len(scene.p_WF))
    return Seen(
        scene.p_WF + error.p[:-1],
        RigidTransform(turn_B @ X_WB.rotation(), X_WB.translation() + error.p[-1]),
        RigidTransform(turn_O @ X_WO.rotation(), X_WO.translation()),
        # A felt force is never negative.
        scene.contact * np.maximum(factor, 0) * config.touch,
        scene.X_WP,
    )


def averaged(before: np.ndarray | None, now: np.ndarray, config: OperatorConfig) -> np.ndarray:
    """Returns the low-passed value over about `judging_time`; single samples are noisier than the tolerances.

    `before` is the average one period ago; None at the first sample.
    """
    if before is None:
        return now
    return before + config.period / (config.period + config.judging_time) * (now - before)


@dc.dataclass(frozen=True)
class SensedGain:
    """The person's estimate of robot fingertip motion per own fingertip motion.

    People adapt to a new visuomotor gain within a few movements (Krakauer et al. 2000). The estimate is one
    number for the whole hand, Σ |Δrobot| |Δown| / Σ |Δown|², over free motions between samples at least
    `interval` apart. It starts at one.
    """

    # At the last sample: time, s; own and robot fingertips (F, 3) in their hands' frames, m.
    t: float = -np.inf
    own: np.ndarray | None = None
    robot: np.ndarray | None = None
    # The two sums, m².
    product: float = 1e-4
    square: float = 1e-4

    interval = 0.25  # s

    @property
    def ratio(self) -> float:
        """Robot motion per own motion."""
        return self.product / self.square

    def update(self, t: float, own: np.ndarray, robot: np.ndarray, free: np.ndarray) -> "SensedGain":
        """Returns the estimate after a sample at time t, s; only `free` (F,) fingers count."""
        if t - self.t < self.interval:
            return self
        if self.own is None or self.robot is None:
            return dc.replace(self, t=t, own=own, robot=robot)
        own_step = np.linalg.norm(own - self.own, axis=1)
        robot_step = np.linalg.norm(robot - self.robot, axis=1)
        # Noise hides smaller motions.
        use = free & (own_step > 0.005)
        return SensedGain(
            t,
            own,
            robot,
            self.product + float((own_step * robot_step)[use].sum()),
            self.square + float((own_step**2)[use].sum()),
        )
