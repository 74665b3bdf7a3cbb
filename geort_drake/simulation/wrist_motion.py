"""Minimum-jerk movements of a wrist or hand from one rest to the next."""

import dataclasses as dc
import functools

import numpy as np
from pydrake.math import RigidTransform
from scipy.spatial.transform import Rotation

from geort_drake.systems.port_values import rotation_of_vector


@dc.dataclass
class WristMovement:
    """A minimum-jerk movement (Flash and Hogan 1985) between two poses X_WH; times in s."""

    X_start: RigidTransform
    X_end: RigidTransform
    t_start: float
    duration: float

    @property
    def t_end(self) -> float:
        return self.t_start + self.duration

    def pose(self, t: float) -> RigidTransform:
        """Returns the pose at time t: on a straight line, rotated about a fixed axis."""
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
