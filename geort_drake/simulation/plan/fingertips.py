"""Plans postures of a hand whose fingertips must reach given points."""

from collections.abc import Collection, Iterable, Sequence

import numpy as np
from scipy.optimize import least_squares

from geort_drake.errors import ScenarioError
from geort_drake.hands.description import HandDescription
from geort_drake.hands.hand import Hand
from geort_drake.simulation.person.goal import Plan

_TOLERANCE = 0.001  # m, largest position error of a fingertip
_LIMIT_MARGIN = 0.1  # fraction of its range that a joint keeps from either limit
_COMFORT = 1e-3  # m per range; weight of a joint's distance from the middle of its range


class FingerPlanner:
    """Finds postures in which the tips of K fingers are at given points; the others keep their defaults.

    Attributes:
        hand: model of the hand alone.
        fingers: (K,) indices of the fingers among all F of the description.
        radius: (K,) radii of their tips, m.
        touches: (F,) whether a finger is one of the K.
        side: sign of y in B towards the index finger: 1 for a right hand, −1 for a left one.

    Args:
        needed: names of the K fingers.
        task: start of the error message for a hand that lacks one of them, such as "the keys need".

    Raises:
        ScenarioError: the hand lacks one of the fingers.
    """

    def __init__(self, description: HandDescription, needed: Sequence[str], task: str):
        require_fingers(description, needed, task)
        known = description.finger_names
        self.hand = Hand(description)
        self.fingers = np.array([known.index(name) for name in needed])
        self.radius = np.array([description.fingers[index].tip_radius for index in self.fingers])
        self.touches = np.isin(known, needed)
        self.side = -1.0 if description.side == "left" else 1.0
        joints = [name for index in self.fingers for name in description.fingers[index].joints]
        self._columns = np.array([self.hand.joint_names.index(name) for name in joints])
        self._context = self.hand.contact_context()

    def best_first(self, plans: Sequence[Plan], aim: str) -> list[Plan]:
        """Returns plans by their cost; raises ScenarioError without any, as the hand cannot `aim`."""
        if not plans:
            raise ScenarioError(f"hand '{self.hand.description.name}' cannot {aim}")
        return sorted(plans, key=lambda plan: plan.cost)

    def discomfort(self, q: np.ndarray) -> float:
        """Mean square distance of the fingers' joints from the middle of their ranges, in ranges."""
        return float(np.mean(self._from_middle(q) ** 2))

    def _from_middle(self, q: np.ndarray) -> np.ndarray:
        lower, upper = self.hand.lower[self._columns], self.hand.upper[self._columns]
        return (q[self._columns] - 0.5 * (lower + upper)) / (upper - lower)

    def all_tips(self, p_BF: np.ndarray) -> np.ndarray:
        """Returns fingertip points (F, 3), m: p_BF (K, 3) for the K fingers, NaN for the others."""
        tips = np.full((len(self.touches), 3), np.nan)
        tips[self.fingers] = p_BF
        return tips

    def tips_point_down(self, q: np.ndarray, least: float) -> bool:
        """Whether the last links of the fingers point along x of B, by at least the sine `least`."""
        self.hand.query(q, self._context)
        context = self.hand.plant.GetMyContextFromRoot(self._context)
        for index in self.fingers:
            finger = self.hand.description.fingers[index]
            link = self.hand.plant.GetBodyByName(finger.tip_link, self.hand.instance)
            tip = link.EvalPoseInWorld(context).rotation().matrix() @ np.asarray(finger.tip_point)
            if tip[0] < least * np.linalg.norm(tip):
                return False
        return True

    def is_clear(self, q: np.ndarray, p_BQ: np.ndarray, gap: float, ignored: Collection[str] = ()) -> bool:
        """Whether no links but fingertips and ignored ones are within `gap`, m, of p_BQ (N, 3)."""
        query, hand = self.hand.query(q, self._context), self.hand
        return not any(
            found.distance < gap
            and not hand.are_tips(found.id_G, found.id_G)
            and hand.link_of(found.id_G) not in ignored
            for p in p_BQ
            for found in query.ComputeSignedDistanceToPoint(p, gap)
        )

    def reach(self, p_BF: np.ndarray, guess: np.ndarray) -> np.ndarray | None:
        """Returns joint positions (n,), rad, near `guess` with the fingertips at p_BF (K, 3), m, or None.

        Only the tips may touch each other, and the joints keep a margin to their limits.
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
        tip_error = np.linalg.norm(found.fun[: p_BF.size].reshape(-1, 3), axis=1).max()
        if tip_error > _TOLERANCE or hand.collides_beyond_tips(q):
            return None
        return q


def require_fingers(description: HandDescription, needed: Iterable[str], task: str) -> None:
    """Raises ScenarioError if a hand lacks a finger; the message starts with `task`, e.g. "the keys need"."""
    for name in needed:
        if name not in description.finger_names:
            has = ", ".join(description.finger_names)
            raise ScenarioError(f"{task} a {name}; hand '{description.name}' has: {has}")
