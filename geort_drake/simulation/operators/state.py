"""Phases and memory of the simulated person."""

import dataclasses as dc
import enum

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.simulation.operators.intention import LearnedMotion
from geort_drake.simulation.operators.perception import SensedGain, VisualError
from geort_drake.simulation.wrist_motion import WristMovement
from geort_drake.systems.port_values import Immutable


class Phase(enum.IntEnum):
    """Phases of a person who grasps or places an object."""

    REACH = 0  # moves the hand in front of the object and opens the fingers
    APPROACH = 1  # moves the hand around the object
    SURROUND = 2  # moves the fingertips to just before the surface
    CLOSE = 3  # moves them onto the surface
    SQUEEZE = 4
    LIFT = 5
    HOLD = 6
    RELEASE = 7  # opens the fingers and moves back after the object slipped
    CARRY = 8  # moves the held object above its place
    LOWER = 9
    OPEN = 10
    RETREAT = 11  # moves the open hand away


@dc.dataclass
class OperatorState(Immutable):
    """The person's memory between decisions. Frames: H person's wrist, B robot hand base.

    `GraspingPerson.step` changes only a copy of it.
    """

    theta: np.ndarray  # (20,) joint angles of the own hand H, rad
    X_WH: RigidTransform
    # (5, 3) own fingertips in H at the last decisions, m; the oldest are as old as the seen scene, the newest
    # are those before this decision.
    p_HF_past: tuple[np.ndarray, ...]
    sensed: SensedGain
    visual_error: VisualError
    phase: Phase = Phase.REACH
    phase_start: float = 0.0
    attempt: int = 1
    finger_velocity: np.ndarray = dc.field(default_factory=lambda: np.zeros((5, 3)))
    # The wrist's present or last movement in this phase, and the number of movements.
    movement: WristMovement | None = None
    movements: int = 0
    # Averages over time, m: own fingertips in H, when the seen scene was, and robot's in B, (2, F, 3);
    # errors of the robot's fingertips in B, (F, 3); the object's origin in B, (3,).
    fingertips: np.ndarray | None = None
    shape_error: np.ndarray | None = None
    p_BO: np.ndarray | None = None
    # Smallest error of a fingertip in this phase, and when it last fell.
    best_error: float = np.inf
    best_time: float = 0.0
    # Squeeze: own fingertips at its start, and the inward directions, (F, 3).
    p_HF_start: np.ndarray | None = None
    n_BF: np.ndarray | None = None
    # Lift: the object's origin in B at its start.
    p_BO_start: np.ndarray | None = None
    # For `PlacingPerson`: errors of the seen place relative to the object.
    place_error: VisualError | None = None
    # For `IntendingPerson`: the learned response of the robot; the remaining intended motion of its
    # fingertips in this phase, (F, 3) m in B; and own fingertips (5, 3) before they closed, m in H.
    learned: LearnedMotion | None = None
    intended: np.ndarray | None = None
    p_HF_open: np.ndarray | None = None
