"""Finds where a hand can hold a handle in its palm while the index finger is on a pad."""

import dataclasses as dc

import numpy as np
from pydrake.geometry import QueryObject

from geort_drake.errors import ScenarioError
from geort_drake.hands.chains import palm_links
from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_reach import FingerReach
from geort_drake.simulation.tasks.trigger.goal import BACK, FINGERS, LENGTH, RADIUS, TriggerGoal

PAD_TRAVEL, PAD_WANTED = 0.008, 0.004  # m, of the pad: all, and wanted
PAD_HEIGHT = RADIUS + PAD_TRAVEL + 0.002  # m, from the handle's axis to the pad's top at rest
HOVER = 0.010  # m, gap between a waiting fingertip and handle or pad
SQUEEZE = 0.020  # m, of fingertips beyond the handle's surface
_PITCH = 0.045  # m, between fingertips along the handle
_CLEARANCE = 0.010  # m, by which free play may miss a fingertip's place
# Places of the handle's axis along the fingers from the hand base, m, and tilts of the fingers' side from
# straight out of the palm, rad, that are tried.
_Z, _TILT = np.arange(-0.06, 0.061, 0.005), np.deg2rad(np.arange(-30, 31, 15))
# The handle rests on the palm at these distances from its middle, within this, m.
SUPPORT, _REST = 0.04, 0.002


@dc.dataclass(frozen=True)
class TriggerPlan:
    """A place of the handle, with joint positions (n,), rad, of the hand.

    Attributes:
        q_open, q_held: off handle and pad; and squeezing, with the index finger off the pad.
        q_pulled: squeezing, the index finger as far inside the pad's end as the others inside the handle.
        discomfort: mean square distance of the fingers' joints from the middle of their ranges.
    """

    goal: TriggerGoal
    q_open: np.ndarray
    q_held: np.ndarray
    q_pulled: np.ndarray
    discomfort: float


class TriggerPlanner:
    """Plans how a hand holds the handle.

    Raises:
        ScenarioError: the hand lacks one of `FINGERS`.
    """

    def __init__(self, description: HandDescription):
        self._robot = FingerReach(description, FINGERS, "the trigger needs")
        hand = self._robot.hand
        self._palm = {link.name() for link in palm_links(hand.plant, description, hand.instance)}
        self._context = hand.contact_context()

    def plans(self) -> list[TriggerPlan]:
        """All places that the hand can hold, the most comfortable first; deterministic.

        Raises:
            ScenarioError: there is none.
        """
        found = []
        for z in _Z:
            p_BH = self._on_palm(z)
            if p_BH is not None:
                found += [plan for tilt in _TILT if (plan := self._plan(p_BH, tilt)) is not None]
        if not found:
            raise ScenarioError(
                f"hand '{self._robot.hand.description.name}' cannot hold a handle of {2000 * RADIUS:.0f} mm "
                "between its palm and two fingers"
            )
        return sorted(found, key=lambda plan: plan.discomfort)

    def _on_palm(self, z: float) -> np.ndarray | None:
        """(3,) centre in B of a handle that rests on the palm of the hand, m, or None."""
        query = self._robot.hand.query(self._robot.hand.default_position, self._context)
        y = self._robot.hand.fingertips(self._robot.hand.default_position)[self._robot.fingers[1], 1]
        x = 0.2
        while x > 0.0:
            gaps = [
                self._gap(query, np.array([x - BACK, y + end, z]), palm=True) for end in (-SUPPORT, SUPPORT)
            ]
            if min(gaps) < 1e-4:
                return np.array([x, y, z]) if max(gaps) < _REST else None
            x -= 0.5 * min(gaps)
        return None

    def _gap(self, query: QueryObject, p_BQ: np.ndarray, palm: bool) -> float:
        """Distance of the handle's surface at a point of its axis from the palm, or from finger links, m."""
        hand, tips = self._robot.hand, self._robot.hand.are_tips
        near = [
            found.distance
            for found in query.ComputeSignedDistanceToPoint(p_BQ, 0.2)
            if (hand.link_of(found.id_G) in self._palm) == palm and not tips(found.id_G, found.id_G)
        ]
        return min(near, default=0.2) - RADIUS

    def _plan(self, p_BH: np.ndarray, tilt: float) -> TriggerPlan | None:
        robot, hand = self._robot, self._robot.hand
        side = -1.0 if hand.description.side == "left" else 1.0
        n_B = np.array([np.cos(tilt), 0.0, np.sin(tilt)])
        along = np.outer([side * _PITCH, 0.0, -side * _PITCH], [0.0, 1.0, 0.0])

        def off(*gaps: float) -> np.ndarray:
            """(3, 3) fingertip points with these gaps, m, to pad and handle."""
            height = np.array([PAD_HEIGHT, RADIUS, RADIUS]) + robot.radius + gaps
            return p_BH + along + height[:, None] * n_B

        touch = off(-PAD_WANTED, 0.0, 0.0)
        q_open = robot.reach(off(HOVER, HOVER, HOVER), hand.default_position)
        q_touch = None if q_open is None else robot.reach(touch, q_open)
        if (
            q_open is None
            or q_touch is None
            or not (self._is_clear(q_open, p_BH) and self._is_clear(q_touch, p_BH))
        ):
            return None
        q_held = robot.reach(off(HOVER, -SQUEEZE, -SQUEEZE), q_touch)
        q_pulled = robot.reach(off(-PAD_TRAVEL - SQUEEZE, -SQUEEZE, -SQUEEZE), q_touch)
        if q_held is None or q_pulled is None:
            return None
        p_BF_open = hand.fingertips(hand.default_position)
        p_BF_touch = p_BF_open.copy()
        p_BF_open[robot.fingers], p_BF_touch[robot.fingers] = off(HOVER, HOVER, HOVER), touch
        goal = TriggerGoal(
            finger_names=tuple(hand.finger_names),
            trigger=int(robot.fingers[0]),
            touches=np.isin(np.arange(len(p_BF_open)), robot.fingers),
            p_BH=p_BH,
            n_B=n_B,
            p_BF_open=p_BF_open,
            p_BF_touch=p_BF_touch,
            clearance=_CLEARANCE,
            travel=PAD_WANTED,
        )
        return TriggerPlan(goal, q_open, q_held, q_pulled, robot.discomfort(q_touch))

    def _is_clear(self, q: np.ndarray, p_BH: np.ndarray) -> bool:
        """Whether only fingertips are closer than a millimetre to the handle."""
        query = self._robot.hand.query(q, self._context)
        axis = p_BH + np.outer(np.arange(-LENGTH / 2, LENGTH / 2 + 1e-6, 0.01), [0.0, 1.0, 0.0])
        return min(self._gap(query, p - [off, 0, 0], palm=False) for p in axis for off in (0.0, BACK)) > 0.001
