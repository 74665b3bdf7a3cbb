"""Finds where a robot hand can hold a cap and turn it."""

import dataclasses as dc
import itertools

import numpy as np

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_planner import FingerPlan, FingerPlanner
from geort_drake.simulation.operators.goal import Goal

RADIUS, HEIGHT = 0.020, 0.025  # m
FINGERS = ("thumb", "index", "middle")
GAP, SQUEEZE = 0.010, 0.020  # m; distance of open fingertips from the cap, depth of squeezing ones
_CLEARANCE = 0.010  # m; distance by which free play may miss a fingertip's place
# Positions of the cap in B to try, m; and angles between index and middle finger around it, rad, the smaller
# first, because fingers slip less at it.
_X, _Y, _Z = np.arange(0.06, 0.131, 0.02), np.arange(-0.02, 0.061, 0.02), np.arange(-0.02, 0.081, 0.02)
_APART = np.deg2rad([60, 70])
_STEP, _MIN_STROKE = np.deg2rad(10), np.deg2rad(40)
_LINK_CLEARANCE = 0.002  # m; least distance of finger links from the cap


@dc.dataclass(frozen=True)
class CapGoal(Goal):
    """A cap between the fingertips of a parked hand.

    Frames: B the hand base; F a fingertip point. The cap's axis is along x of B. The cap rises along −x when
    it is unscrewed.
    """

    thumb: int  # index of the thumb
    # (3,) middle of the cap in B, m.
    p_BC: np.ndarray
    # (F, 3) fingertips in B that touch the cap at the beginning of a stroke, m.
    p_BF_touch: np.ndarray
    # Turn of the cap in a stroke about −x of B, rad, and distance of open fingertips from the cap, m.
    stroke: float
    gap: float

    @property
    def p_BF_open(self) -> np.ndarray:
        """(F, 3) open fingertips in B at the beginning of a stroke, m."""
        return self.fingertips(0.0, -self.gap)

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return self.p_BF_open, self.fingertips(self.stroke, -self.gap)

    def fingertips(self, turn: float, depth: float | np.ndarray) -> np.ndarray:
        """Returns fingertips (F, 3) in B around the cap, m.

        Args:
            turn: turn since the beginning of the stroke, rad.
            depth: number or (F,), depth below the surface, m: of the thumb towards the axis, of the others
                towards the thumb.
        """
        p = self.p_BF_touch - self.p_BC
        inwards = -p[self.thumb] / np.linalg.norm(p[self.thumb])
        signs = np.where(np.arange(len(p)) == self.thumb, 1.0, -1.0)
        p = p + np.outer(signs * depth, inwards)
        c, s = np.cos(turn), np.sin(turn)
        turned = p.copy()
        turned[:, 1], turned[:, 2] = c * p[:, 1] + s * p[:, 2], c * p[:, 2] - s * p[:, 1]
        return self.p_BC + np.where(self.touches[:, None], turned, self.p_BF_touch - self.p_BC)

    def mirrored(self) -> "CapGoal":
        return dc.replace(super().mirrored(), stroke=-self.stroke)


@dc.dataclass(frozen=True)
class CapPlan(FingerPlan[CapGoal]):
    """A position of the cap, with postures (S, n) at S equal steps of a stroke: `q_open` off the cap.

    Attributes:
        q_held: (S, n) postures that squeeze the cap, rad.
    """

    q_held: np.ndarray


class CapPlanner(FingerPlanner[CapPlan]):
    """Plans how a hand turns a cap; the longest strokes are the best."""

    needed, task = FINGERS, "the cap needs"
    aim = f"turn a cap of {2000 * RADIUS:.0f} mm by {np.rad2deg(_MIN_STROKE):.0f}° with {', '.join(FINGERS)}"

    def __init__(self, description: HandDescription):
        super().__init__(description)
        # Points on the cap's surface, relative to its middle.
        around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        ring = RADIUS * np.column_stack([np.zeros(12), np.cos(around), np.sin(around)])
        top = np.array([-HEIGHT / 2, 0.0, 0.0])
        self._surface = np.vstack([top, ring + top, ring - top])

    def _find(self) -> list[CapPlan]:
        places = [np.array([x, self.side * y, z]) for x, y, z in itertools.product(_X, _Y, _Z)]
        found: list[CapPlan] = []
        for apart in _APART:
            found = found or [plan for p_BC in places if (plan := self._plan(p_BC, apart)) is not None]
        return found

    def _rank(self, plan: CapPlan) -> tuple[float, ...]:
        return -round(plan.goal.stroke, 6), plan.discomfort

    def _plan(self, p_BC: np.ndarray, apart: float) -> CapPlan | None:
        hand = self.hand
        angles = 0.5 * np.array([-np.pi, np.pi - apart, np.pi + apart])
        around = np.column_stack([np.zeros(3), self.side * np.cos(angles), np.sin(angles)])
        middle = CapGoal(
            finger_names=tuple(hand.finger_names),
            touches=self.touches,
            clearance=_CLEARANCE,
            thumb=int(self.fingers[0]),
            p_BC=p_BC,
            p_BF_touch=self.all_tips(p_BC + (RADIUS + self.radius)[:, None] * around),
            stroke=0.0,
            gap=GAP,
        )
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
        return CapPlan(goal, self.discomfort(first[1]), q_open, q_held)

    def _path(self, goal: CapGoal, first: tuple[np.ndarray, np.ndarray], sign: int) -> list[tuple]:
        """Returns postures step by step in one direction, as far as the hand reaches."""
        path: list[tuple] = []
        while (
            len(path) < 18
            and (found := self._postures(goal, sign * _STEP * (len(path) + 1), path[-1] if path else first))
            is not None
        ):
            path.append(found)
        return path

    def _postures(self, goal: CapGoal, turn: float, guess: tuple[np.ndarray, np.ndarray]) -> tuple | None:
        """Returns open and squeezing joint positions (n,), rad, or None."""
        q_open = self.reach(goal.fingertips(turn, -GAP)[self.fingers], guess[0])
        q_touch = None if q_open is None else self.reach(goal.fingertips(turn, 0.0)[self.fingers], q_open)
        if q_open is None or q_touch is None:
            return None
        if not all(self.is_clear(q, goal.p_BC + self._surface, _LINK_CLEARANCE) for q in (q_open, q_touch)):
            return None
        q_held = self.reach(goal.fingertips(turn, SQUEEZE)[self.fingers], q_touch)
        return None if q_held is None else (q_open, q_held)
