"""Finds where a hand can hold the puck and move it to all targets."""

import dataclasses as dc
import math

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_planner import FingerPlan, FingerPlanner
from geort_drake.simulation.operators.goal import Goal
from geort_drake.systems.port_values import rotation_of_vector

RADIUS, HEIGHT = 0.020, 0.030  # m, of the puck
FINGERS = ("thumb", "index", "middle")
SHIFT, TURN = 0.010, math.radians(20)  # of targets: along each axis, m; about x and y, rad
HOVER = 0.020  # m, gap between a waiting fingertip and the puck
_SPREAD = np.deg2rad(40.0)  # angle of each finger around the puck from opposite the thumb
_CLEARANCE = 0.010  # m, distance by which free play may miss a fingertip's place
_LINK_CLEARANCE = 0.001  # m, least gap between puck and links other than fingertips
# Positions of the puck along x and z of B to try, m, and tilts of its axis from the palm's normal, rad.
_X, _Z = np.arange(0.06, 0.121, 0.01), np.arange(-0.02, 0.061, 0.01)
_TILT = np.deg2rad(np.arange(-45, 31, 15))


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


TrackingPlan = FingerPlan[TrackingGoal]


class TrackingPlanner(FingerPlanner[TrackingPlan]):
    """Plans grips of the puck that reach all targets."""

    needed, task = FINGERS, "tracking needs"
    aim = f"move a puck of {2000 * RADIUS:.0f} mm between its thumb and two fingers to all targets"

    def __init__(self, description: HandDescription):
        super().__init__(description)
        angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        circle = RADIUS * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(12)])
        self._edges = np.vstack([circle + [0, 0, z] for z in (-HEIGHT / 2, HEIGHT / 2)])

    def _find(self) -> list[TrackingPlan]:
        return [
            plan for x in _X for z in _Z for tilt in _TILT if (plan := self._plan(x, z, tilt)) is not None
        ]

    def _plan(self, x: float, z: float, tilt: float) -> TrackingPlan | None:
        hand = self.hand
        y = hand.fingertips(hand.default_position)[self.fingers[1:], 1].mean()
        # x of the grip points from the thumb to the fingers.
        R_BG = RotationMatrix.MakeYRotation(np.pi / 2 - tilt) @ RotationMatrix.MakeZRotation(np.pi)
        X_BG = RigidTransform(R_BG, [x, y, z])
        angles = np.array([np.pi, self.side * _SPREAD, -self.side * _SPREAD])
        n_G = np.column_stack([np.cos(angles), -np.sin(angles), np.zeros(3)])
        n_B = np.zeros((len(self.touches), 3))
        n_B[self.fingers] = n_G @ R_BG.matrix().T
        off = X_BG.translation() + (RADIUS + self.radius)[:, None] * n_B[self.fingers]
        goal = TrackingGoal(
            finger_names=tuple(hand.finger_names),
            touches=self.touches,
            clearance=_CLEARANCE,
            X_BG=X_BG,
            p_BF_open=self.all_tips(off + HOVER * n_B[self.fingers]),
            p_BF_touch=self.all_tips(off),
            n_B=n_B,
        )
        q_touch = self.reach(off, 0.5 * (hand.lower + hand.upper))
        if q_touch is None or not self.is_clear(q_touch, X_BG.multiply(self._edges.T).T, _LINK_CLEARANCE):
            return None
        found = []
        for p_BF in goal.places():
            if (q := self.reach(p_BF[self.fingers], q_touch)) is None:
                return None
            found.append(q)
        return TrackingPlan(goal, self.discomfort(q_touch), found[0])
