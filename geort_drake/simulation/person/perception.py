"""Perception of the simulated person: what is seen and felt, with errors of vision and touch."""

import dataclasses as dc
import functools
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.simulation.person.config import OperatorConfig
from geort_drake.systems.port_values import rotation_of_vector, vector_to_pose

# The person looks ahead and down, along this direction in W.
GAZE_W = np.array([0.8, 0.0, -0.6])


@dc.dataclass(frozen=True)
class Percept:
    """The scene as the person sees it."""

    p_WF: np.ndarray  # (F, 3) robot fingertips, m
    X_WB: RigidTransform  # robot hand base
    X_WO: RigidTransform  # object
    contact: np.ndarray  # (F,) force between each robot finger and the object, N
    X_WP: RigidTransform | None = None  # where the object belongs
    values: Mapping[str, np.ndarray] = dc.field(default_factory=dict)  # of the task, by name

    @classmethod
    def of_ports(cls, values: Mapping[str, np.ndarray]) -> "Percept":
        """Returns the scene from the values of ports; without `place_pose`, the object has no place."""
        poses = {name: vector_to_pose(value) for name, value in values.items() if name.endswith("_pose")}
        return cls(
            p_WF=values["fingertips"].reshape(-1, 3),
            X_WB=poses["hand_pose"],
            X_WO=poses["object_pose"],
            contact=values["contact"],
            X_WP=poses.get("place_pose"),
            values=values,
        )

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


def draw_errors(num_fingers: int, config: OperatorConfig, rng: np.random.Generator) -> np.ndarray:
    """Draws errors of vision (F + 5, 3), independent of earlier ones.

    They are position errors of F fingertips, hand and place relative to the object, in W, m; then rotation
    errors of object, hand and place as rotation vectors, rad.
    """
    n = rng.normal(size=(num_fingers + 2, 3))
    across, along = config.visual_noise, config.visual_depth_noise
    p = across * n + (along - across) * (n.dot(GAZE_W)[:, None] * GAZE_W)
    return np.concatenate([p, rng.normal(0, config.visual_turn_noise, (3, 3))])


def later_errors(errors: np.ndarray, config: OperatorConfig, rng: np.random.Generator) -> np.ndarray:
    """Returns the errors of vision one period later."""
    share = math.exp(-config.period / config.visual_noise_time) if config.visual_noise_time else 0.0
    return share * errors + math.sqrt(1 - share**2) * draw_errors(len(errors) - 5, config, rng)


def perceive(scene: Percept, errors: np.ndarray, config: OperatorConfig, rng: np.random.Generator) -> Percept:
    """Returns the scene with errors of vision, see `draw_errors`, and with new noise on forces at each call.

    Only positions relative to the object matter, so the object's own position has no error.
    """
    p_F, p_B, p_P = errors[:-5], errors[-5], errors[-4]
    turn_O, turn_B, turn_P = map(rotation_of_vector, errors[-3:])

    def moved(X: RigidTransform, turn: RotationMatrix, p: np.ndarray) -> RigidTransform:
        return RigidTransform(turn @ X.rotation(), X.translation() + p)

    factor = 1 + rng.normal(0, config.contact_noise, len(scene.p_WF))
    return Percept(
        scene.p_WF + p_F,
        moved(scene.X_WB, turn_B, p_B),
        moved(scene.X_WO, turn_O, np.zeros(3)),
        # A felt force is never negative.
        scene.contact * np.maximum(factor, 0) * config.touch,
        scene.X_WP and moved(scene.X_WP, turn_P, p_P),
        scene.values,
    )


def average(average: np.ndarray | None, value: np.ndarray, config: OperatorConfig) -> np.ndarray:
    """Returns the low-passed value over about `judging_time`; single samples are noisier than the tolerances.

    `average` is that of one period ago: None at first, and NaN where there was no value. There, the value is
    returned.
    """
    if average is None:
        return value
    change = config.period / (config.period + config.judging_time) * (value - average)
    return np.where(np.isnan(average), value, average + change)
