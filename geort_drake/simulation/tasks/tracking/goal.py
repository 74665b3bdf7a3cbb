"""The goal of in-grasp tracking: how three fingertips hold a puck, and where it shall be moved."""

import dataclasses as dc
import math

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.people.keypoints import mirrored
from geort_drake.simulation.operators.perception import FreePlay
from geort_drake.systems.port_values import mirrored_pose, rotation_of_vector

RADIUS, HEIGHT = 0.020, 0.030  # m, of the puck
FINGERS = ("thumb", "index", "middle")
SHIFT, TURN = 0.010, math.radians(20)  # of the targets along each axis, m; and about x and y, rad


def targets() -> list[RigidTransform]:
    """Poses X_GT of the ten targets relative to the grip, where the puck's axis is z."""
    steps = [sign * axis for axis in np.eye(3) for sign in (-1, 1)]
    shifts = [RigidTransform(SHIFT * step) for step in steps]
    return shifts + [RigidTransform(rotation_of_vector(TURN * step), [0, 0, 0]) for step in steps[:4]]


@dc.dataclass(frozen=True)
class TrackingGoal:
    """A puck between fingertips.

    Frames: B the hand base; G the puck in the grip, its axis along z; F a fingertip point.
    """

    # Robot fingers, in the hand description's order, and (F,) whether they hold.
    finger_names: tuple[str, ...]
    touches: np.ndarray
    X_BG: RigidTransform
    # (F, 3) fingertip points in B, m, off the puck and touching it, and directions away from it. Those of
    # other fingers do not matter.
    p_BF_open: np.ndarray
    p_BF_touch: np.ndarray
    n_B: np.ndarray
    # m, by which free play may miss fingertip points.
    clearance: float
    # What the person saw before.
    play: FreePlay | None = None

    def places(self) -> list[np.ndarray]:
        """Fingertip points (F, 3) in B, m, off the puck, and touching it at each target."""
        X_GB = self.X_BG.inverse()
        moves = [self.X_BG @ X_GT @ X_GB for X_GT in targets()]
        return [self.p_BF_open, *(X.multiply(self.p_BF_touch.T).T for X in moves)]

    def mirrored(self) -> "TrackingGoal":
        """Returns the goal reflected in the xz-planes of its frames; the person's own hand is not."""
        play = self.play and self.play._replace(p_BF=mirrored(self.play.p_BF))
        return dc.replace(
            self,
            play=play,
            X_BG=mirrored_pose(self.X_BG),
            p_BF_open=mirrored(self.p_BF_open),
            p_BF_touch=mirrored(self.p_BF_touch),
            n_B=mirrored(self.n_B),
        )
