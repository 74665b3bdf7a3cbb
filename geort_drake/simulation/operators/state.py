"""What a person who grasps sees, remembers and is doing."""

import dataclasses as dc
import enum
import functools

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.simulation.operators.sensed_gain import SensedGain
from geort_drake.simulation.operators.wrist_motion import WristMovement


class Phase(enum.IntEnum):
    """What the person is doing."""

    REACH = 0  # hand to a place before the object, fingers opened
    APPROACH = 1  # hand around the object
    SURROUND = 2  # fingertips to just before the surface
    CLOSE = 3  # onto the surface
    SQUEEZE = 4
    LIFT = 5
    HOLD = 6
    RELEASE = 7  # it slipped: open, and back to where REACH ends


@dc.dataclass(frozen=True)
class Seen:
    """The scene as the person sees it: late, and with noise."""

    p_WF: np.ndarray  # (F, 3) robot fingertip points, m
    X_WB: RigidTransform  # robot hand base
    X_WO: RigidTransform  # object
    contact: np.ndarray  # (F,) felt force between each robot finger and the object, N

    @functools.cached_property
    def X_BW(self) -> RigidTransform:
        """The world in the robot hand base."""
        return self.X_WB.inverse()

    @functools.cached_property
    def p_BF(self) -> np.ndarray:
        """(F, 3) robot fingertip points in the hand base, m."""
        return self.X_BW.multiply(self.p_WF.T).T


@dc.dataclass
class OperatorState:
    """All that the person remembers from one decision to the next."""

    theta: np.ndarray  # (20,) joint angles of the own hand, rad
    X_WH: RigidTransform
    # (5, 3) own fingertips at the last decisions, the oldest at the time of what is now seen, the newest at
    # the joint angles that `step` is given.
    p_HF_past: tuple[np.ndarray, ...]
    # How far the robot's fingertips were seen to move for the own ones' motion.
    sensed: SensedGain
    phase: Phase = Phase.REACH
    phase_start: float = 0.0
    attempt: int = 1
    finger_velocity: np.ndarray = dc.field(default_factory=lambda: np.zeros((5, 3)))
    # The wrist's present or last movement in this phase, and how many there were.
    movement: WristMovement | None = None
    movements: int = 0
    # What is judged from several looks, see `judged`, m: own fingertips in H when the picture was made, and
    # the robot's in B, (2, F, 3); where the robot's should go in this phase, (F, 3) in B; the object's
    # origin in B, (3,).
    fingertips: np.ndarray | None = None
    shape_error: np.ndarray | None = None
    p_BO: np.ndarray | None = None
    # Smallest error of a fingertip in this phase, and when it last fell.
    best_error: float = np.inf
    best_time: float = 0.0
    # Squeeze: where the own fingertips started, and which way is inwards, (F, 3).
    p_HF_start: np.ndarray | None = None
    n_BF: np.ndarray | None = None
    # Lift: the object's place in the hand when it began.
    p_BO_start: np.ndarray | None = None
