"""The joint angles of a human hand that reproduce keypoints, by a generic solver."""

import numpy as np
from scipy.optimize import least_squares

from geort_drake.people.synthetic.hand import HumanHand

EXACT = {"xtol": 1e-13, "ftol": 1e-13, "gtol": 1e-13}
TIP_WEIGHT = 10.0  # over that of the other keypoints
DIFFERENCE = 1e-7  # rad, of the finite differences


def fitted_keypoints(hand: HumanHand, p_HK: np.ndarray) -> np.ndarray:
    """(T, 21, 3) m, of the hand within its limits, nearest to keypoints p_HK (T, 21, 3); tips first."""
    weight = np.ones((21, 1))
    weight[4::4] = TIP_WEIGHT
    bounds, middle = (hand.lower, hand.upper), (hand.lower + hand.upper) / 2
    theta, found = middle, []
    for frame in np.asarray(p_HK, float):

        def residuals(x, frame=frame):
            return (weight * (hand.keypoints(x) - frame)).ravel()

        def jacobian(x):
            ahead, behind = hand.keypoints(x + np.stack([DIFFERENCE * np.eye(20), -DIFFERENCE * np.eye(20)]))
            return (weight * (ahead - behind) / (2 * DIFFERENCE)).reshape(20, -1).T

        # From the frame before and from the middle, as either may end in another minimum.
        starts = (np.clip(start, hand.lower + 1e-9, hand.upper - 1e-9) for start in (theta, middle))
        solved = [least_squares(residuals, start, jacobian, bounds=bounds, **EXACT) for start in starts]
        theta = min(solved, key=lambda one: one.cost).x
        found.append(hand.keypoints(theta))
    return np.array(found)
