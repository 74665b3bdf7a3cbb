"""Metrics of what touches: do fingertips meet where they should, and nothing else where it should not?"""

from collections.abc import Sequence

import numpy as np

from geort_drake.hands.model import HandModel
from geort_drake.people.recording import PINCH_M
from geort_drake.retargeting.training.map_figures import pinched_distances

APART_DISTANCE = 0.030  # m, human fingertips farther apart do not mean to pinch
TOO_DEEP = 0.004  # m, nearer robot fingertips fight each other
PENETRATION = 0.002  # m, deeper penetrations count as self-collision


def pinch(
    frames: np.ndarray, p_BF: np.ndarray, finger_names: Sequence[str], tip_radius: float
) -> dict | None:
    """Do the robot's thumb and finger meet where the person's do?

    `closed`, `too_deep`, `mean_mm`, `p95_mm` and `frames` are of the nearest thumb–finger pair in
    frames in which it is under 15 mm apart (None if there are none), `all_pairs` of all such pairs;
    `false` is the share of pairs over 30 mm apart in which the robot's meet. Robot fingertips meet
    when their spheres touch: centres at most two tip radii apart. None for a hand without a thumb.

    Args:
        frames: (T, F, 3) human fingertips, m.
        p_BF: (T, F, 3) the robot's, m.
        finger_names: F names.
        tip_radius: of the robot's fingertips, m.
    """
    if "thumb" not in finger_names or len(finger_names) == 1:
        return None
    thumb = list(finger_names).index("thumb")
    others = [i for i in range(len(finger_names)) if i != thumb]
    human = np.linalg.norm(frames[:, others] - frames[:, [thumb]], axis=-1)
    robot = np.linalg.norm(p_BF[:, others] - p_BF[:, [thumb]], axis=-1)
    apart = human > APART_DISTANCE

    def figures(distance: np.ndarray) -> dict:
        if len(distance) == 0:
            return dict.fromkeys(("closed", "too_deep", "mean_mm", "p95_mm")) | {"frames": 0}
        return {
            "closed": float((distance <= 2 * tip_radius).mean()),
            "too_deep": float((distance < TOO_DEEP).mean()),
            "mean_mm": float(1000 * distance.mean()),
            "p95_mm": float(1000 * np.percentile(distance, 95)),
            "frames": len(distance),
        }

    return figures(pinched_distances(human, robot, PINCH_M)) | {
        "false": float((robot[apart] <= 2 * tip_radius).mean()) if apart.any() else None,
        "all_pairs": figures(robot[human < PINCH_M]),
    }


def self_collision(hand: HandModel, q: np.ndarray) -> dict[str, float]:
    """Shares of joint angles (T, n) that collide.

    `deep` counts penetrations over 2 mm between links that are not both fingertips, `any` every contact.
    """
    touching = np.asarray(hand.collides(q), dtype=bool)
    deep = [
        any(depth > PENETRATION and not tip_tip for depth, _, _, tip_tip in hand.penetrations(row))
        for row in q[touching]
    ]
    return {"deep": sum(deep) / len(q), "any": float(touching.mean())}
