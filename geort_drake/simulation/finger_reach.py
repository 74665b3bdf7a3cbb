"""Postures of a hand in which some fingertips are at given places."""

import numpy as np
from scipy.optimize import least_squares

from geort_drake.errors import ScenarioError
from geort_drake.hands.description import HandDescription
from geort_drake.hands.model import HandModel

_TOLERANCE = 0.001  # m, of fingertips
_LIMIT_MARGIN = 0.1  # fraction of its range that a joint keeps from either limit
_COMFORT = 1e-3  # m, weight of the distance of a joint from the middle of its range, per range


class FingerReach:
    """Finds postures with the tips of K fingers at given places; the other fingers stay as by default.

    Attributes:
        hand: the hand alone.
        fingers: (K,) numbers of the fingers in the description.
        radius: (K,) of their tips, m.

    Args:
        needed: names of the fingers.
        who: who needs them, for the error.

    Raises:
        ScenarioError: the hand lacks one of the fingers.
    """

    def __init__(self, description: HandDescription, needed: tuple[str, ...], who: str):
        known = [finger.name for finger in description.fingers]
        for name in needed:
            if name not in known:
                raise ScenarioError(f"{who} a {name}; hand '{description.name}' has: {', '.join(known)}")
        self.hand = HandModel(description)
        self.fingers = np.array([known.index(name) for name in needed])
        self.radius = np.array([description.fingers[index].tip_radius for index in self.fingers])
        joints = [name for index in self.fingers for name in description.fingers[index].joints]
        self._columns = np.array([self.hand.joint_names.index(name) for name in joints])

    def discomfort(self, q: np.ndarray) -> float:
        """Mean square distance of the fingers' joints from the middle of their ranges, in ranges."""
        return float(np.mean(self._from_middle(q) ** 2))

    def _from_middle(self, q: np.ndarray) -> np.ndarray:
        lower, upper = self.hand.lower[self._columns], self.hand.upper[self._columns]
        return (q[self._columns] - 0.5 * (lower + upper)) / (upper - lower)

    def reach(self, p_BF: np.ndarray, guess: np.ndarray) -> np.ndarray | None:
        """Joint positions (n,), rad, with the fingertips at p_BF (K, 3), m, or None.

        The hand does not touch itself but with its tips, and the joints keep off their limits.
        """
        hand, columns = self.hand, self._columns
        margin = _LIMIT_MARGIN * (hand.upper - hand.lower)
        bounds = (hand.lower + margin)[columns], (hand.upper - margin)[columns]

        def posture(x: np.ndarray) -> np.ndarray:
            q = np.tile(hand.default_position, (*x.shape[:-1], 1))
            q[..., columns] = x
            return q

        def residuals(x: np.ndarray) -> np.ndarray:
            error = hand.fingertips(posture(x))[self.fingers] - p_BF
            return np.concatenate([error.ravel(), _COMFORT * self._from_middle(posture(x))])

        def jacobian(x: np.ndarray) -> np.ndarray:
            step = 1e-6
            p = hand.fingertips(posture(x + step * np.vstack([np.zeros_like(x), np.eye(len(x))])))
            p = p[:, self.fingers].reshape(len(x) + 1, -1)
            ranges = (hand.upper - hand.lower)[columns]
            return np.vstack([(p[1:] - p[0]).T / step, np.diag(_COMFORT / ranges)])

        start = np.clip(guess[columns], *bounds)
        found = least_squares(residuals, start, jacobian, bounds, max_nfev=60)
        q = posture(found.x)
        missed = np.linalg.norm(found.fun[: p_BF.size].reshape(-1, 3), axis=1).max()
        if missed > _TOLERANCE or hand.collides_beyond_tips(q):
            return None
        return q
