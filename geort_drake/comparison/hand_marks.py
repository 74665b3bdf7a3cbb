"""Marks in recordings of maps: which hands collide, which pinches close, and the colours for it."""

import numpy as np

from geort_drake.colours import FINGER_COLOURS, Color, rgb
from geort_drake.comparison.metrics import PENETRATION
from geort_drake.hands.model import HandModel

RIGHT, WRONG = (90, 255, 120), (255, 50, 50)  # no finger has these colours


def finger_colors(hand: HandModel) -> list[Color]:
    """One for each finger, in the model's order."""
    return [rgb(FINGER_COLOURS[name]) for name in hand.finger_names]


def pinch_closed(hand: HandModel, tips: np.ndarray) -> np.ndarray:
    """Whether the spheres of two robot fingertips (T, 2, 3), m, touch: (T,)."""
    return np.linalg.norm(tips[:, 1] - tips[:, 0], axis=-1) <= 2 * hand.tip_radius


def collisions(hand: HandModel, q: np.ndarray) -> list[np.ndarray]:
    """Where parts of the hand penetrate each other by over 2 mm: for each of q (T, n), (k, 3) in B, m.

    Two fingertips may touch, as in `metrics.self_collision`.
    """
    context = hand.contact_context()
    found = []
    for row in q:
        pairs = hand.query(row, context).ComputePointPairPenetration()
        deep = [(pair.p_WCa + pair.p_WCb) / 2 for pair in pairs if pair.depth > PENETRATION]
        found.append(np.array(deep).reshape(-1, 3))
    return found
