"""Plans postures of a hand whose fingertips must reach given points."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from geort_drake.errors import ScenarioError
from geort_drake.hands.description import HandDescription
from geort_drake.hands.hand import Hand
from geort_drake.simulation.person.goal import Goal
from geort_drake.simulation.plan.inverse_kinematics import TipKinematics, solve

_TOLERANCE = 5e-4  # m, largest error of a fingertip along each axis


class Plan(NamedTuple):
    """A goal of the person, and postures of the robot's hand that reach it.

    Attributes:
        cost: how uncomfortable the posture is; plans with lower costs come first.
        postures: name → (n,) or (steps, n) joint positions of the hand, rad; the person does not know them.
    """

    goal: Goal
    cost: tuple[float, ...]
    postures: Mapping[str, Any]


class FingerPlanner:
    """Finds postures in which the tips of K fingers are at given points; the others keep their defaults.

    Attributes:
        hand: model of the hand alone.
        fingers: (K,) indices of the fingers among all F of the description.
        radius: (K,) radii of their tips, m.
        touches: (F,) whether a finger is one of the K.
        side: sign of y in B towards the index finger: 1 for a right hand, −1 for a left one.

    Args:
        fingers: names of the K fingers.
        task: start of the error message for a hand that lacks one of them, such as "the keys need".

    Raises:
        ScenarioError: the hand lacks one of the fingers.
    """

    def __init__(self, description: HandDescription, fingers: Sequence[str], task: str):
        require_fingers(description, fingers, task)
        known = description.finger_names
        self.hand = Hand(description)
        self.fingers = np.array([known.index(name) for name in fingers])
        self.radius = np.array([description.fingers[index].tip_radius for index in self.fingers])
        self.touches = np.isin(known, fingers)
        self.side = -1.0 if description.side == "left" else 1.0
        self._joints = [name for index in self.fingers for name in description.fingers[index].joints]
        self._columns = np.array([self.hand.joint_names.index(name) for name in self._joints])
        self._context, plant = self.hand.contact_context(), self.hand.plant
        context = plant.GetMyMutableContextFromRoot(self._context)
        self._tips = tips = TipKinematics(plant, context, self.hand.description, self.hand.instance)
        self._order = np.array([tips.index[name] for name in self.hand.joint_names])
        tips.low[self._order], tips.high[self._order] = self.hand.lower, self.hand.upper

    def best_first(self, plans: Sequence[Plan], aim: str) -> list[Plan]:
        """Returns plans by their cost; raises ScenarioError without any, as the hand cannot `aim`."""
        if not plans:
            raise ScenarioError(f"hand '{self.hand.description.name}' cannot {aim}")
        return sorted(plans, key=lambda plan: plan.cost)

    def discomfort(self, q: np.ndarray) -> float:
        """Mean square distance of the fingers' joints from the middle of their ranges, in ranges."""
        lower, upper = self.hand.lower[self._columns], self.hand.upper[self._columns]
        return float(np.mean(((q[self._columns] - 0.5 * (lower + upper)) / (upper - lower)) ** 2))

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

    def is_clear(self, q: np.ndarray, p_BQ: np.ndarray, gap: float) -> bool:
        """Whether no links but fingertips are within `gap`, m, of p_BQ (N, 3)."""
        query, hand = self.hand.query(q, self._context), self.hand
        return not any(
            near.distance < gap and not hand.are_tips(near.id_G, near.id_G)
            for p in p_BQ
            for near in query.ComputeSignedDistanceToPoint(p, gap)
        )

    def reach(self, p_BF: np.ndarray, guess: np.ndarray) -> np.ndarray | None:
        """Returns joint positions (n,), rad, near `guess` with the fingertips at p_BF (K, 3), m, or None.

        Only the tips may touch each other, and the joints keep a margin to their limits.
        """
        hand, tips = self.hand, self._tips
        names = [hand.finger_names[index] for index in self.fingers]
        places = {name: (p - _TOLERANCE, p + _TOLERANCE) for name, p in zip(names, p_BF, strict=True)}
        base = hand.plant.GetFrameByName(hand.description.base_frame, hand.instance)
        weight, moved = np.zeros(len(tips.low)), self._order[self._columns]
        weight[moved] = (tips.high - tips.low)[moved] ** -2
        ik = tips.program(base, places, weight, 0.5 * (tips.low + tips.high))
        tips.keep_from_limits(ik, self._joints)
        idle = np.delete(self._order, self._columns)
        rest = np.delete(hand.default_position, self._columns)
        ik.get_mutable_prog().AddBoundingBoxConstraint(rest, rest, ik.q()[idle])
        hand.query(np.clip(guess, hand.lower, hand.upper), self._context)
        solution = solve(ik, hand.plant.GetPositions(tips.context))
        if solution is None or hand.collides_beyond_tips(q := solution[1][self._order]):
            return None
        return q


def require_fingers(description: HandDescription, needed: Iterable[str], task: str) -> None:
    """Raises ScenarioError if a hand lacks a finger; the message starts with `task`, e.g. "the keys need"."""
    for name in needed:
        if name not in description.finger_names:
            has = ", ".join(description.finger_names)
            raise ScenarioError(f"{task} a {name}; hand '{description.name}' has: {has}")
