"""Finds where a hand can hold the puck so that it can move it to all targets."""

import dataclasses as dc

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.errors import ScenarioError
from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_reach import FingerReach
from geort_drake.simulation.tasks.tracking.goal import FINGERS, HEIGHT, RADIUS, TrackingGoal

HOVER = 0.020  # m, gap between a waiting fingertip and the puck
_SPREAD = np.deg2rad(40.0)  # of the two fingers from opposite the thumb, around the puck
_CLEARANCE = 0.010  # m, by which free play may miss a fingertip's place
_LINK_CLEARANCE = 0.001  # m, least gap between puck and links other than fingertips
# Places of the puck out of the palm and along the fingers, m, and tilts of its axis from straight out of the
# palm, rad, that are tried.
_X, _Z = np.arange(0.06, 0.121, 0.01), np.arange(-0.02, 0.061, 0.01)
_TILT = np.deg2rad(np.arange(-45, 31, 15))


@dc.dataclass(frozen=True)
class TrackingPlan:
    """A grip of the puck, with joint positions q_open (n,), rad, of the hand off it.

    Attributes:
        discomfort: mean square distance of the fingers' joints from the middle of their ranges.
    """

    goal: TrackingGoal
    q_open: np.ndarray
    discomfort: float


class TrackingPlanner:
    """Plans how a hand holds the puck.

    Raises:
        ScenarioError: the hand lacks one of `FINGERS`.
    """

    def __init__(self, description: HandDescription):
        self._robot = FingerReach(description, FINGERS, "tracking needs")
        self._context = self._robot.hand.contact_context()
        angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        circle = RADIUS * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(12)])
        self._edges = np.vstack([circle + [0, 0, z] for z in (-HEIGHT / 2, HEIGHT / 2)])

    def plans(self) -> list[TrackingPlan]:
        """All grips that reach all targets, the most comfortable first; deterministic.

        Raises:
            ScenarioError: there is none.
        """
        found = [
            plan for x in _X for z in _Z for tilt in _TILT if (plan := self._plan(x, z, tilt)) is not None
        ]
        if not found:
            raise ScenarioError(
                f"hand '{self._robot.hand.description.name}' cannot move a puck of {2000 * RADIUS:.0f} mm "
                "between its thumb and two fingers to all targets"
            )
        return sorted(found, key=lambda plan: plan.discomfort)

    def _plan(self, x: float, z: float, tilt: float) -> TrackingPlan | None:
        robot, hand = self._robot, self._robot.hand
        p_BF_rest = hand.fingertips(hand.default_position)
        side = -1.0 if hand.description.side == "left" else 1.0
        y = p_BF_rest[robot.fingers[1:], 1].mean()
        # x of the grip points from the thumb to the fingers.
        R_BG = RotationMatrix.MakeYRotation(np.pi / 2 - tilt) @ RotationMatrix.MakeZRotation(np.pi)
        X_BG = RigidTransform(R_BG, [x, y, z])
        angles = np.array([np.pi, side * _SPREAD, -side * _SPREAD])
        n_G = np.column_stack([np.cos(angles), -np.sin(angles), np.zeros(3)])
        n_B, p_BF_open, p_BF_touch = np.zeros_like(p_BF_rest), p_BF_rest.copy(), p_BF_rest.copy()
        n_B[robot.fingers] = n_G @ R_BG.matrix().T
        off = X_BG.translation() + (RADIUS + robot.radius)[:, None] * n_B[robot.fingers]
        p_BF_touch[robot.fingers], p_BF_open[robot.fingers] = off, off + HOVER * n_B[robot.fingers]
        goal = TrackingGoal(
            tuple(hand.finger_names),
            np.isin(np.arange(len(n_B)), robot.fingers),
            X_BG,
            p_BF_open,
            p_BF_touch,
            n_B,
            _CLEARANCE,
        )
        q_touch = robot.reach(off, 0.5 * (hand.lower + hand.upper))
        if q_touch is None or not self._is_clear(q_touch, X_BG):
            return None
        found = []
        for p_BF in goal.places():
            if (q := robot.reach(p_BF[robot.fingers], q_touch)) is None:
                return None
            found.append(q)
        return TrackingPlan(goal, found[0], robot.discomfort(q_touch))

    def _is_clear(self, q: np.ndarray, X_BG: RigidTransform) -> bool:
        """Whether only fingertips are near the edges of the puck."""
        query, tips = self._robot.hand.query(q, self._context), self._robot.hand.are_tips
        return not any(
            found.distance < _LINK_CLEARANCE and not tips(found.id_G, found.id_G)
            for p_BQ in X_BG.multiply(self._edges.T).T
            for found in query.ComputeSignedDistanceToPoint(p_BQ, 0.02)
        )
