"""The goal of in-grasp tracking: how three fingertips hold a puck, and the targets for it."""

import dataclasses as dc
import math

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.simulation.operators.goal import Goal
from geort_drake.systems.port_values import rotation_of_vector

RADIUS, HEIGHT = 0.020, 0.030  # m, of the puck
FINGERS = ("thumb", "index", "middle")
SHIFT, TURN = 0.010, math.radians(20)  # of targets: along each axis, m; about x and y, rad


def targets() -> list[RigidTransform]:
    """Returns poses X_GT of the ten targets relative to the grip G, whose z is the puck's axis."""
    steps = [sign * axis for axis in np.eye(3) for sign in (-1, 1)]
    shifts = [RigidTransform(SHIFT * step) for step in steps]
    return shifts + [RigidTransform(rotation_of_vector(TURN * step), [0, 0, 0]) for step in steps[:4]]


@dc.dataclass(frozen=True)
class TrackingGoal(Goal):
    """A puck between fingertips.

    Frames: B the hand base; G the puck in the grip, its axis along z; F a fingertip point.
    """

    X_BG: RigidTransform
    # (F, 3) fingertips in B, m, off the puck and touching it, and unit vectors away from it.
    p_BF_open: np.ndarray
    p_BF_touch: np.ndarray
    n_B: np.ndarray

    def places(self) -> list[np.ndarray]:
        """Returns fingertips off the puck, and touching it at each target."""
        X_GB = self.X_BG.inverse()
        moves = [self.X_BG @ X_GT @ X_GB for X_GT in targets()]
        return [self.p_BF_open, *(X.multiply(self.p_BF_touch.T).T for X in moves)]
