"""What of a hand touches in nearly every posture, and a posture in which nothing does."""

from collections import Counter

import numpy as np

from geort_drake.hands.model import HandModel

# A pair that touches in this part of random postures is built that way.
_ALWAYS = 0.95
_POSTURES = 100
# Openness of the fingers that is tried first, as part of each joint's way into its range.
_OPENINGS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)


def contact_shares(hand: HandModel, seed: int = 0) -> dict[tuple[str, str], float]:
    """Pairs of links, and in which part of random postures they touch; pairs of fingertips left out."""
    rng = np.random.default_rng(seed)
    counts: Counter[tuple[str, str]] = Counter()
    for q in rng.uniform(hand.lower, hand.upper, (_POSTURES, len(hand.joint_names))):
        counts.update({(a, b) for _, a, b, tips in hand.penetrations(q) if not tips})
    return {pair: count / _POSTURES for pair, count in counts.items()}


def resting_contacts(hand: HandModel) -> list[list[str]]:
    """Pairs of links that touch in nearly every posture, in alphabetical order."""
    return sorted([a, b] for (a, b), share in contact_shares(hand).items() if share >= _ALWAYS and a != b)


def free_posture(hand: HandModel, seed: int = 0) -> np.ndarray | None:
    """(n,) joint positions free of self-collision near where the hand starts; None if none was found."""
    start = hand.default_position
    for opening in _OPENINGS:
        q = start + opening * (0.5 * (hand.lower + hand.upper) - start)
        if not hand.collides(q):
            return q
    q = np.random.default_rng(seed).uniform(hand.lower, hand.upper, (_POSTURES, len(start)))
    free = q[~hand.collides(q)]
    return free[np.linalg.norm(free - start, axis=1).argmin()] if len(free) else None
