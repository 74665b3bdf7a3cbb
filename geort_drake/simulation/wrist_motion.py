"""Minimum-jerk movements of a wrist or hand from rest to rest."""

import dataclasses as dc
import functools
from typing import TYPE_CHECKING

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

from geort_drake.systems.port_values import rotation_of_vector

if TYPE_CHECKING:
    from geort_drake.simulation.person.config import OperatorConfig


@dc.dataclass
class WristMovement:
    """A minimum-jerk movement (Flash and Hogan 1985) between two poses X_WH; times in s."""

    X_start: RigidTransform
    X_end: RigidTransform
    t_start: float
    duration: float

    @classmethod
    def planned(
        cls,
        X_WH: RigidTransform,
        shift: np.ndarray,
        turn: RotationMatrix,
        t: float,
        config: "OperatorConfig",
        rng: np.random.Generator,
        peak_speed: str = "peak_wrist_speed",
    ) -> "WristMovement":
        """Plans a movement from X_WH by shift (m) and turn in W, with motor noise, that starts at t (s).

        `peak_speed` is the name of the parameter that limits its speed.
        """
        error = rng.normal(0, config.motor_noise / np.sqrt(3), 3) * np.linalg.norm(shift)
        # A minimum-jerk movement peaks at 15/8 of its mean speed.
        duration = max(
            config.min_movement_time,
            1.875 * float(np.linalg.norm(shift)) / getattr(config, peak_speed),
            1.875 * float(Rotation.from_matrix(turn.matrix()).magnitude()) / config.peak_wrist_turn,
        )
        X_end = RigidTransform(turn @ X_WH.rotation(), X_WH.translation() + shift + error)
        return cls(X_WH, X_end, t, duration)

    @property
    def t_end(self) -> float:
        return self.t_start + self.duration

    def pose(self, t: float) -> RigidTransform:
        """Returns the pose at time t, s, on a straight line and rotated about a fixed axis."""
        s = minimum_jerk((t - self.t_start) / self.duration)
        p = self.X_start.translation() + s * (self.X_end.translation() - self.X_start.translation())
        return RigidTransform(self.X_start.rotation() @ rotation_of_vector(self._rotation_vector * s), p)

    @functools.cached_property
    def _rotation_vector(self) -> np.ndarray:
        R_SE = self.X_start.rotation().inverse() @ self.X_end.rotation()
        return Rotation.from_matrix(R_SE.matrix()).as_rotvec()


def minimum_jerk(s: float) -> float:
    """Returns the progress in [0, 1] at the relative time s: 10 s³ − 15 s⁴ + 6 s⁵."""
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)
