"""Finds where three keys can be under a robot hand, and the postures above and on them."""

import dataclasses as dc

import numpy as np
from scipy.optimize import least_squares

from geort_drake.errors import ScenarioError
from geort_drake.hands.description import HandDescription
from geort_drake.hands.model import HandModel
from geort_drake.simulation.tasks.keys.goal import FINGERS, PITCH, KeysGoal

HOVER = 0.010  # m, gap between a waiting fingertip and its key
TRAVEL = 0.005  # m, of a key
_CLEARANCE = 0.008  # m, by which free play may miss a fingertip's place above its key
# Distances of the keys' tops from the hand base that are tried, along x and z of B, m.
_X, _Z = np.arange(0.05, 0.141, 0.01), np.arange(-0.02, 0.121, 0.01)
_TOLERANCE = 0.001  # m, of fingertips
_LIMIT_MARGIN = 0.1  # fraction of its range that a joint keeps from either limit
# The last link must point down by this much, so that its tip touches first: sine of the angle.
_LEAST_SLOPE = 0.5
_COMFORT = 1e-3  # m, weight of the distance of a joint from the middle of its range, per range


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
        names = [finger.name for finger in description.fingers]
        for needed in FINGERS:
            if needed not in names:
                raise ScenarioError(
                    f"the keys need a {needed}; hand '{description.name}' has: {', '.join(names)}"
                )
        self._hand = HandModel(description)
        self._key_of = np.array([FINGERS.index(name) if name in FINGERS else -1 for name in names])
        self._pressing = [names.index(name) for name in FINGERS]
        joints = [name for index in self._pressing for name in description.fingers[index].joints]
        self._columns = np.array([self._hand.joint_names.index(name) for name in joints])
        self._radius = np.array([description.fingers[index].tip_radius for index in self._pressing])
        self._context = self._hand.contact_context()

    def plans(self) -> list[KeysPlan]:
        """All places of the keys that the hand can reach, the most comfortable first; deterministic.

        Raises:
            ScenarioError: there is none.
        """
        found = [plan for x in _X for z in _Z if (plan := self._plan(x, z)) is not None]
        if not found:
            raise ScenarioError(
                f"hand '{self._hand.description.name}' cannot reach three keys {1000 * PITCH:.0f} mm apart"
            )
        return sorted(found, key=lambda plan: plan.discomfort)

    def _plan(self, x: float, z: float) -> KeysPlan | None:
        hand = self._hand
        side = -1.0 if hand.description.side == "left" else 1.0
        y = hand.fingertips(hand.default_position)[self._pressing[1], 1]
        p_BK = np.array([[x, y + side * offset, z] for offset in (PITCH, 0.0, -PITCH)])
        above = p_BK - np.outer(self._radius + HOVER, [1.0, 0.0, 0.0])
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
        p_BF_open[self._pressing] = above
        names = tuple(hand.finger_names)
        p_BF_pressed = p_BF_open + [HOVER + TRAVEL, 0.0, 0.0]
        goal = KeysGoal(names, p_BK, self._key_of, p_BF_open, p_BF_pressed, _CLEARANCE)
        return KeysPlan(goal, q_open, q_pressed, float(np.mean(self._from_middle(q_open) ** 2)))

    def _from_middle(self, q: np.ndarray) -> np.ndarray:
        lower, upper = self._hand.lower[self._columns], self._hand.upper[self._columns]
        return (q[self._columns] - 0.5 * (lower + upper)) / (upper - lower)

    def _reach(self, p_BF: np.ndarray, guess: np.ndarray) -> np.ndarray | None:
        """Joint positions with the pressing fingertips at p_BF (3, 3), m, without collision; or None."""
        hand, columns = self._hand, self._columns
        margin = _LIMIT_MARGIN * (hand.upper - hand.lower)
        bounds = (hand.lower + margin)[columns], (hand.upper - margin)[columns]

        def posture(x: np.ndarray) -> np.ndarray:
            q = np.tile(hand.default_position, (*x.shape[:-1], 1))
            q[..., columns] = x
            return q

        def residuals(x: np.ndarray) -> np.ndarray:
            error = hand.fingertips(posture(x))[self._pressing] - p_BF
            return np.concatenate([error.ravel(), _COMFORT * self._from_middle(posture(x))])

        def jacobian(x: np.ndarray) -> np.ndarray:
            step = 1e-6
            p = hand.fingertips(posture(x + step * np.vstack([np.zeros_like(x), np.eye(len(x))])))
            p = p[:, self._pressing].reshape(len(x) + 1, -1)
            ranges = (hand.upper - hand.lower)[columns]
            return np.vstack([(p[1:] - p[0]).T / step, np.diag(_COMFORT / ranges)])

        start = np.clip(guess[columns], *bounds)
        found = least_squares(residuals, start, jacobian, bounds, max_nfev=60)
        q = posture(found.x)
        missed = np.linalg.norm(found.fun[: p_BF.size].reshape(-1, 3), axis=1).max()
        if missed > _TOLERANCE or hand.collides_beyond_tips(q) or not self._tips_point_down(q):
            return None
        return q

    def _tips_point_down(self, q: np.ndarray) -> bool:
        hand = self._hand
        hand.query(q, self._context)
        context = hand.plant.GetMyContextFromRoot(self._context)
        for index in self._pressing:
            finger = hand.description.fingers[index]
            link = hand.plant.GetBodyByName(finger.tip_link, hand.instance)
            tip = link.EvalPoseInWorld(context).rotation().matrix() @ np.asarray(finger.tip_point)
            if tip[0] < _LEAST_SLOPE * np.linalg.norm(tip):
                return False
        return True
