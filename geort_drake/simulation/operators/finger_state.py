"""Memory of a person who moves the robot's fingers but not the wrist."""

import dataclasses as dc
import enum

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.simulation.operators.intention import LearnedMotion
from geort_drake.simulation.operators.perception import VisualError
from geort_drake.systems.port_values import Immutable


@dc.dataclass
class FingerState(Immutable):
    """The person's memory between decisions; `FingerPerson.step` changes only a copy of it."""

    theta: np.ndarray  # (20,) joint angles of the own hand, rad
    X_WH: RigidTransform
    # (5, 3) own fingertips in H at the last decisions, m; the oldest are as old as the seen scene.
    p_HF_past: tuple[np.ndarray, ...]
    sight: VisualError
    learned: LearnedMotion
    # (5, 3) own fingertips of the relaxed hand, and of the open hand that begins the task, m; and duration of
    # the movement between the two, s.
    p_HF_rest: np.ndarray
    p_HF_open: np.ndarray
    settle_time: float
    phase: enum.IntEnum
    phase_start: float = 0.0
    looking: bool = False  # whether the person has seen the scene yet
    attempt: int = 1
    finger: int = -1  # robot finger that acts
    # (5, 3) own fingertips when the last press and release began, m.
    p_HF_press: np.ndarray | None = None
    p_HF_release: np.ndarray | None = None
    finger_velocity: np.ndarray = dc.field(default_factory=lambda: np.zeros((5, 3)))
    # (F, 3) intended position of each robot fingertip in B, m.
    reference: np.ndarray = dc.field(default_factory=lambda: np.zeros((0, 3)))
    # Finger that is looked at, since when, and when each finger was last looked at (F,), s.
    attended: int = -1
    attended_since: float = 0.0
    looked: np.ndarray = dc.field(default_factory=lambda: np.zeros(0))
    # Own and robot fingertip (3,), m, at the last comparison of their motions, and its time, s.
    compared: tuple[np.ndarray, np.ndarray] | None = None
    compared_at: float = 0.0
    # (3, 3) matrix applied to the present movement: motor error in direction and size.
    motor: np.ndarray = dc.field(default_factory=lambda: np.eye(3))
