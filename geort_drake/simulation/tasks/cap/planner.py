"""Finds where a robot hand can hold a cap and turn it."""

import dataclasses as dc
import itertools

import numpy as np

from geort_drake.errors import ScenarioError
from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_reach import FingerReach
from geort_drake.simulation.tasks.cap.goal import FINGERS, HEIGHT, RADIUS, CapGoal

GAP, SQUEEZE = 0.010, 0.020  # m, of fingertips from the cap's surface, and beyond it
_CLEARANCE = 0.010  # m, by which free play may miss a fingertip's place
# Places of the cap in B that are tried, m; and angles between index and middle finger around it, rad. In a
# smaller one, they slip less.
_X, _Y, _Z = np.arange(0.06, 0.131, 0.02), np.arange(-0.02, 0.061, 0.02), np.arange(-0.02, 0.081, 0.02)
_APART = np.deg2rad([60, 70])
_STEP, _MIN_STROKE = np.deg2rad(10), np.deg2rad(40)
_LINK_CLEARANCE = 0.002  # m, of finger links from the cap


@dc.dataclass(frozen=True)
class CapPlan:
    """A place of the cap, with joint positions (K, n), rad, at K equal steps of a stroke.

    Attributes:
        q_open: off the cap.
        q_held: squeezing it.
        discomfort: mean square distance of the fingers' joints from the middle of their ranges.
    """

    goal: CapGoal
    q_open: np.ndarray
    q_held: np.ndarray
    discomfort: float


class CapPlanner:
    """Plans how a hand turns a cap.

    Raises:
        ScenarioError: the hand lacks one of `FINGERS`.
    """

    def __init__(self, description: HandDescription):
        self._robot = FingerReach(description, FINGERS, "the cap needs")
        self._context = self._robot.hand.contact_context()
        names = tuple(finger.name for finger in description.fingers)
        self._names, self._touches = names, np.isin(names, FINGERS)
        # Points on the cap's surface, from its middle.
        around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        ring = RADIUS * np.column_stack([np.zeros(12), np.cos(around), np.sin(around)])
        top = np.array([-HEIGHT / 2, 0.0, 0.0])
        self._surface = np.vstack([top, ring + top, ring - top])

    def plans(self) -> list[CapPlan]:
        """All places where the hand can turn the cap, the longest strokes first; deterministic.

        Raises:
            ScenarioError: there is none.
        """
        side = -1.0 if self._robot.hand.description.side == "left" else 1.0
        places = [np.array([x, side * y, z]) for x, y, z in itertools.product(_X, _Y, _Z)]
        found: list[CapPlan] = []
        for apart in _APART:
            found = found or [plan for p_BC in places if (plan := self._plan(p_BC, side, apart)) is not None]
        if not found:
            raise ScenarioError(
                f"hand '{self._robot.hand.description.name}' cannot turn a cap of {2000 * RADIUS:.0f} mm by "
                f"{np.rad2deg(_MIN_STROKE):.0f}° with {', '.join(FINGERS)}"
            )
        return sorted(found, key=lambda plan: (-round(plan.goal.stroke, 6), plan.discomfort))

    def _plan(self, p_BC: np.ndarray, side: float, apart: float) -> CapPlan | None:
        hand, fingers = self._robot.hand, self._robot.fingers
        angles = 0.5 * np.array([-np.pi, np.pi - apart, np.pi + apart])
        p_BF = hand.fingertips(hand.default_position)
        p_BF[fingers] = p_BC + (RADIUS + self._robot.radius)[:, None] * np.column_stack(
            [np.zeros(3), side * np.cos(angles), np.sin(angles)]
        )
        middle = CapGoal(self._names, self._touches, int(fingers[0]), p_BC, p_BF, 0.0, GAP, _CLEARANCE)
        first = self._postures(middle, 0.0, (hand.default_position, hand.default_position))
        if first is None:
            return None
        backward, forward = (self._path(middle, first, sign) for sign in (-1, 1))
        path = [*reversed(backward), first, *forward]
        stroke = _STEP * (len(path) - 1)
        if stroke < _MIN_STROKE - 1e-9:
            return None
        p_BF_touch = middle.fingertips(-_STEP * len(backward), 0.0)
        goal = dc.replace(middle, p_BF_touch=p_BF_touch, stroke=stroke)
        q_open, q_held = (np.array(each) for each in zip(*path, strict=True))
        return CapPlan(goal, q_open, q_held, self._robot.discomfort(first[1]))

    def _path(self, goal: CapGoal, first: tuple[np.ndarray, np.ndarray], sign: int) -> list[tuple]:
        """Postures, step by step, as far as the hand reaches."""
        path: list[tuple] = []
        while (
            len(path) < 18
            and (found := self._postures(goal, sign * _STEP * (len(path) + 1), path[-1] if path else first))
            is not None
        ):
            path.append(found)
        return path

    def _postures(self, goal: CapGoal, turn: float, guess: tuple[np.ndarray, np.ndarray]) -> tuple | None:
        """Open and squeezing joint positions (n,), rad, or None."""
        robot = self._robot
        q_open = robot.reach(goal.fingertips(turn, -GAP)[robot.fingers], guess[0])
        q_touch = None if q_open is None else robot.reach(goal.fingertips(turn, 0.0)[robot.fingers], q_open)
        if (
            q_open is None
            or q_touch is None
            or not (self._is_clear(q_open, goal.p_BC) and self._is_clear(q_touch, goal.p_BC))
        ):
            return None
        q_held = robot.reach(goal.fingertips(turn, SQUEEZE)[robot.fingers], q_touch)
        return None if q_held is None else (q_open, q_held)

    def _is_clear(self, q: np.ndarray, p_BC: np.ndarray) -> bool:
        """Whether only fingertips are near the cap."""
        hand = self._robot.hand
        query, are_tips = hand.query(q, self._context), hand.are_tips
        return not any(
            found.distance < _LINK_CLEARANCE and not are_tips(found.id_G, found.id_G)
            for p in self._surface
            for found in query.ComputeSignedDistanceToPoint(p_BC + p, 2 * _LINK_CLEARANCE)
        )
