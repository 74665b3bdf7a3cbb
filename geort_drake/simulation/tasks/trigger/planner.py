"""Finds where a hand can hold a handle in its palm while its index finger reaches a pad."""

import dataclasses as dc

import numpy as np

from geort_drake.hands.chains import palm_links
from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_planner import FingerPlan, FingerPlanner
from geort_drake.simulation.operators.goal import Goal

RADIUS, LENGTH = 0.018, 0.110  # m, of the handle
BACK = 0.034  # m, distance of the handle's axis from its back, two balls of the same radius on the palm
FINGERS = ("index", "middle", "ring")  # the first presses the pad, the others hold the handle
PAD_TRAVEL, PAD_WANTED = 0.008, 0.004  # m, full and wanted travel of the pad
PAD_HEIGHT = RADIUS + PAD_TRAVEL + 0.002  # m, from the handle's axis to the pad's top at rest
HOVER = 0.010  # m, gap between a waiting fingertip and handle or pad
SQUEEZE = 0.020  # m, depth of squeezing fingertips below the handle's surface
_PITCH = 0.045  # m, distance between fingertips along the handle
_CLEARANCE = 0.010  # m, distance by which free play may miss a fingertip's place
# Positions of the handle's axis along z of B to try, m, and tilts of its fingers' side from the palm's
# normal, rad.
_Z, _TILT = np.arange(-0.06, 0.061, 0.005), np.deg2rad(np.arange(-30, 31, 15))
# The handle rests on the palm at distances ±SUPPORT from its middle, with gaps of at most _REST, m.
SUPPORT, _REST = 0.04, 0.002
_LINK_CLEARANCE = 0.001  # m, least gap between handle and links other than fingertips and the palm's


@dc.dataclass(frozen=True)
class TriggerGoal(Goal):
    """A handle between palm and fingers, and a pad on it under one fingertip.

    Frames: B the hand base; F a fingertip point. The handle's axis is along y of B.
    """

    trigger: int  # index of the finger that presses the pad
    # (3,) centre of the handle in B, m; and unit vector from the palm's side to the fingers' side.
    p_BH: np.ndarray
    n_B: np.ndarray
    # (F, 3) fingertips in B, m: off handle and pad; and touching the handle, or on the pad at its wanted
    # travel.
    p_BF_open: np.ndarray
    p_BF_touch: np.ndarray
    # Wanted travel of the pad, m.
    travel: float

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return self.p_BF_open, self.p_BF_touch


@dc.dataclass(frozen=True)
class TriggerPlan(FingerPlan[TriggerGoal]):
    """A position of the handle; `q_open` is off handle and pad.

    Attributes:
        q_held: (n,) posture that squeezes the handle, with the index finger off the pad, rad.
        q_pulled: (n,) the same, with the index finger SQUEEZE beyond the pad's full travel, rad.
    """

    q_held: np.ndarray
    q_pulled: np.ndarray


class TriggerPlanner(FingerPlanner[TriggerPlan]):
    """Plans how a hand holds the handle."""

    needed, task = FINGERS, "the trigger needs"
    aim = f"hold a handle of {2000 * RADIUS:.0f} mm between its palm and two fingers"

    def __init__(self, description: HandDescription):
        super().__init__(description)
        links = palm_links(self.hand.plant, description, self.hand.instance)
        self._palm = {link.name() for link in links}

    def _find(self) -> list[TriggerPlan]:
        found = []
        for z in _Z:
            p_BH = self._on_palm(z)
            if p_BH is not None:
                found += [plan for tilt in _TILT if (plan := self._plan(p_BH, tilt)) is not None]
        return found

    def _on_palm(self, z: float) -> np.ndarray | None:
        """Returns the centre (3,) in B of a handle that rests on the palm, m, or None."""
        hand, tips = self.hand, self.hand.are_tips
        query = hand.query(hand.default_position, self._context)
        y = hand.fingertips(hand.default_position)[self.fingers[1], 1]

        def gap(p_BQ: np.ndarray) -> float:
            """Returns the distance of the handle's surface from the palm at a point of its axis, m."""
            near = [
                found.distance
                for found in query.ComputeSignedDistanceToPoint(p_BQ, 0.2)
                if hand.link_of(found.id_G) in self._palm and not tips(found.id_G, found.id_G)
            ]
            return min(near, default=0.2) - RADIUS

        x = 0.2
        while x > 0.0:
            gaps = [gap(np.array([x - BACK, y + end, z])) for end in (-SUPPORT, SUPPORT)]
            if min(gaps) < 1e-4:
                return np.array([x, y, z]) if max(gaps) < _REST else None
            x -= 0.5 * min(gaps)
        return None

    def _plan(self, p_BH: np.ndarray, tilt: float) -> TriggerPlan | None:
        hand = self.hand
        n_B = np.array([np.cos(tilt), 0.0, np.sin(tilt)])
        along = np.outer([self.side * _PITCH, 0.0, -self.side * _PITCH], [0.0, 1.0, 0.0])

        def off(*gaps: float) -> np.ndarray:
            """Returns fingertips (3, 3) with these gaps, m, to pad and handle."""
            height = np.array([PAD_HEIGHT, RADIUS, RADIUS]) + self.radius + gaps
            return p_BH + along + height[:, None] * n_B

        touch = off(-PAD_WANTED, 0.0, 0.0)
        q_open = self.reach(off(HOVER, HOVER, HOVER), hand.default_position)
        q_touch = None if q_open is None else self.reach(touch, q_open)
        if q_open is None or q_touch is None:
            return None
        axis = p_BH + np.outer(np.arange(-LENGTH / 2, LENGTH / 2 + 1e-6, 0.01), [0.0, 1.0, 0.0])
        both = np.vstack([axis, axis - [BACK, 0.0, 0.0]])
        if not all(self.is_clear(q, both, RADIUS + _LINK_CLEARANCE, self._palm) for q in (q_open, q_touch)):
            return None
        q_held = self.reach(off(HOVER, -SQUEEZE, -SQUEEZE), q_touch)
        q_pulled = self.reach(off(-PAD_TRAVEL - SQUEEZE, -SQUEEZE, -SQUEEZE), q_touch)
        if q_held is None or q_pulled is None:
            return None
        goal = TriggerGoal(
            finger_names=tuple(hand.finger_names),
            touches=self.touches,
            clearance=_CLEARANCE,
            trigger=int(self.fingers[0]),
            p_BH=p_BH,
            n_B=n_B,
            p_BF_open=self.all_tips(off(HOVER, HOVER, HOVER)),
            p_BF_touch=self.all_tips(touch),
            travel=PAD_WANTED,
        )
        return TriggerPlan(goal, self.discomfort(q_touch), q_open, q_held, q_pulled)
