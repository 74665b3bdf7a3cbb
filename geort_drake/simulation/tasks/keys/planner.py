"""Finds goals: positions of three keys under a robot hand, with the postures above and on them."""

import dataclasses as dc

import numpy as np

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_planner import FingerPlan, FingerPlanner
from geort_drake.simulation.operators.goal import Goal

# Size of a key cap along and across the fingers, and distance between the centres of neighbours, m.
CAP_LENGTH, CAP_WIDTH, PITCH = 0.040, 0.018, 0.045
FINGERS = ("index", "middle", "ring")  # finger of each key, from the thumb's side
HOVER = 0.002  # m, gap between a waiting fingertip and its key
TRAVEL = 0.005  # m, full travel of a key
_CLEARANCE = 0.008  # m, distance by which free play may miss a fingertip's place above its key
# Positions of the keys' tops along x and z of B to try, m.
_X, _Z = np.arange(0.05, 0.141, 0.01), np.arange(-0.02, 0.121, 0.01)
# The last link must point down by this much, so that its tip touches first: sine of the angle.
_MIN_SLOPE = 0.5


@dc.dataclass(frozen=True)
class KeysGoal(Goal):
    """Three keys under the fingertips of a parked hand.

    Frames: B the hand base; F a fingertip point. Keys are pressed along +x of B, out of the palm.
    """

    # (3, 3) centre of each key's top at rest in B, m.
    p_BK: np.ndarray
    # (F,) key of each finger, -1 for none.
    key_of: np.ndarray
    # (F, 3) fingertips in B above the keys and on pressed keys, m.
    p_BF_open: np.ndarray
    p_BF_pressed: np.ndarray

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return self.p_BF_open, self.p_BF_pressed


@dc.dataclass(frozen=True)
class KeysPlan(FingerPlan[KeysGoal]):
    """Positions of the keys; `q_open` has all fingertips above them.

    Attributes:
        q_pressed: for each key, `q_open` with one finger on the fully pressed key.
    """

    q_pressed: list[np.ndarray]


class KeysPlanner(FingerPlanner[KeysPlan]):
    """Plans where a hand presses keys."""

    needed, task = FINGERS, "the keys need"
    aim = f"reach three keys {1000 * PITCH:.0f} mm apart"

    def __init__(self, description: HandDescription):
        super().__init__(description)
        self._key_of = np.full(len(self.touches), -1)
        self._key_of[self.fingers] = np.arange(len(self.fingers))

    def _find(self) -> list[KeysPlan]:
        # The hand starts in its default position. Fingers that start inside the keys stay hooked under them.
        start = self.hand.fingertips(self.hand.default_position)[self.fingers, 0] + self.radius
        clear = _X[_X > start.max() + HOVER]
        return [plan for x in clear for z in _Z if (plan := self._plan(x, z)) is not None]

    def _plan(self, x: float, z: float) -> KeysPlan | None:
        hand = self.hand
        y = hand.fingertips(hand.default_position)[self.fingers[1], 1]
        p_BK = np.array([[x, y + self.side * offset, z] for offset in (PITCH, 0.0, -PITCH)])
        above = p_BK - np.outer(self.radius + HOVER, [1.0, 0.0, 0.0])
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
        p_BF_open = self.all_tips(above)
        goal = KeysGoal(
            finger_names=tuple(hand.finger_names),
            touches=self.touches,
            clearance=_CLEARANCE,
            p_BK=p_BK,
            key_of=self._key_of,
            p_BF_open=p_BF_open,
            p_BF_pressed=p_BF_open + [HOVER + TRAVEL, 0.0, 0.0],
        )
        return KeysPlan(goal, self.discomfort(q_open), q_open, q_pressed)

    def _reach(self, p_BF: np.ndarray, guess: np.ndarray) -> np.ndarray | None:
        """Returns joint positions with fingertips at p_BF (3, 3), m, that point down; or None."""
        q = self.reach(p_BF, guess)
        return q if q is not None and self._tips_point_down(q) else None

    def _tips_point_down(self, q: np.ndarray) -> bool:
        hand = self.hand
        hand.query(q, self._context)
        context = hand.plant.GetMyContextFromRoot(self._context)
        for index in self.fingers:
            finger = hand.description.fingers[index]
            link = hand.plant.GetBodyByName(finger.tip_link, hand.instance)
            tip = link.EvalPoseInWorld(context).rotation().matrix() @ np.asarray(finger.tip_point)
            if tip[0] < _MIN_SLOPE * np.linalg.norm(tip):
                return False
        return True
