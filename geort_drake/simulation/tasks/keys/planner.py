"""Finds where three keys can be under a robot hand, and the postures above and on them."""

import dataclasses as dc

import numpy as np

from geort_drake.errors import ScenarioError
from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_reach import FingerReach
from geort_drake.simulation.tasks.keys.goal import FINGERS, PITCH, KeysGoal

HOVER = 0.002  # m, gap between a waiting fingertip and its key
TRAVEL = 0.005  # m, of a key
_CLEARANCE = 0.008  # m, by which free play may miss a fingertip's place above its key
# Distances of the keys' tops from the hand base that are tried, along x and z of B, m.
_X, _Z = np.arange(0.05, 0.141, 0.01), np.arange(-0.02, 0.121, 0.01)
# The last link must point down by this much, so that its tip touches first: sine of the angle.
_MIN_SLOPE = 0.5


@dc.dataclass(frozen=True)
class KeysPlan:
    """A place of the keys, with joint positions (n,), rad, of the hand.

    Attributes:
        q_open: all fingertips above their keys.
        q_pressed: the same with one finger on its fully pressed key, for each key.
        discomfort: mean square distance of the pressing fingers' joints from the middle of their ranges.
    """

    goal: KeysGoal
    q_open: np.ndarray
    q_pressed: list[np.ndarray]
    discomfort: float


class KeysPlanner:
    """Plans keys for a hand.

    Raises:
        ScenarioError: the hand lacks one of `FINGERS`.
    """

    def __init__(self, description: HandDescription):
        self._robot = FingerReach(description, FINGERS, "the keys need")
        fingers = self._robot.fingers.tolist()
        self._key_of = np.array(
            [fingers.index(i) if i in fingers else -1 for i in range(len(description.fingers))]
        )
        self._context = self._robot.hand.contact_context()

    def plans(self) -> list[KeysPlan]:
        """All places of the keys that the hand can reach, the most comfortable first; deterministic.

        Raises:
            ScenarioError: there is none.
        """
        found = [plan for x in _X for z in _Z if (plan := self._plan(x, z)) is not None]
        if not found:
            name = self._robot.hand.description.name
            raise ScenarioError(f"hand '{name}' cannot reach three keys {1000 * PITCH:.0f} mm apart")
        return sorted(found, key=lambda plan: plan.discomfort)

    def _plan(self, x: float, z: float) -> KeysPlan | None:
        hand = self._robot.hand
        side = -1.0 if hand.description.side == "left" else 1.0
        y = hand.fingertips(hand.default_position)[self._robot.fingers[1], 1]
        p_BK = np.array([[x, y + side * offset, z] for offset in (PITCH, 0.0, -PITCH)])
        above = p_BK - np.outer(self._robot.radius + HOVER, [1.0, 0.0, 0.0])
        q_open = self._reach(above, hand.default_position)
        if q_open is None:
            return None
        q_pressed = []
        for key in range(3):
            target = above.copy()
            target[key, 0] += HOVER + TRAVEL
            q = self._reach(target, q_open)
            if q is None:
                return None
            q_pressed.append(q)
        p_BF_open = hand.fingertips(hand.default_position)
        p_BF_open[self._robot.fingers] = above
        names = tuple(hand.finger_names)
        p_BF_pressed = p_BF_open + [HOVER + TRAVEL, 0.0, 0.0]
        goal = KeysGoal(names, p_BK, self._key_of, p_BF_open, p_BF_pressed, _CLEARANCE)
        return KeysPlan(goal, q_open, q_pressed, self._robot.discomfort(q_open))

    def _reach(self, p_BF: np.ndarray, guess: np.ndarray) -> np.ndarray | None:
        """Joint positions with the pressing fingertips at p_BF (3, 3), m, which point down; or None."""
        q = self._robot.reach(p_BF, guess)
        return q if q is not None and self._tips_point_down(q) else None

    def _tips_point_down(self, q: np.ndarray) -> bool:
        hand = self._robot.hand
        hand.query(q, self._context)
        context = hand.plant.GetMyContextFromRoot(self._context)
        for index in self._robot.fingers:
            finger = hand.description.fingers[index]
            link = hand.plant.GetBodyByName(finger.tip_link, hand.instance)
            tip = link.EvalPoseInWorld(context).rotation().matrix() @ np.asarray(finger.tip_point)
            if tip[0] < _MIN_SLOPE * np.linalg.norm(tip):
                return False
        return True
