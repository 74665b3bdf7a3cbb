"""How a person moves the wrist: minimum-jerk movements from one rest to the next."""

import dataclasses as dc
import functools

from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RotationMatrix


@dc.dataclass
class WristMovement:
    """A minimum-jerk movement of the wrist (Flash and Hogan 1985)."""

    X_start: RigidTransform
    X_end: RigidTransform
    t_start: float
    duration: float

    def pose(self, t: float) -> RigidTransform:
        s = minimum_jerk((t - self.t_start) / self.duration)
        p = self.X_start.translation() + s * (self.X_end.translation() - self.X_start.translation())
        turn = AngleAxis(s * self._turn.angle(), self._turn.axis())
        return RigidTransform(self.X_start.rotation() @ RotationMatrix(turn), p)

    @functools.cached_property
    def _turn(self) -> AngleAxis:
        return (self.X_start.rotation().inverse() @ self.X_end.rotation()).ToAngleAxis()

    @property
    def t_end(self) -> float:
        return self.t_start + self.duration


def minimum_jerk(s: float) -> float:
    """Progress in [0, 1] at the relative time s: 10 s³ − 15 s⁴ + 6 s⁵."""
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)
