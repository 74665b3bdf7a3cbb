"""Figures of fingertips: motion, size, coverage, flatness, pinches, posture, collisions, smoothness.

Each is a function of arrays. g = FK∘f maps human fingertips (N, F, 3) in H to robot fingertips (N, F, 3) in
B, m. Figures are means over fingers. Random numbers come from a NumPy Generator.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial import cKDTree

from geort_drake.hands.hand import Hand
from geort_drake.people.recording import PINCH_M
from geort_drake.retargeting.base import thumb_and_others
from geort_drake.retargeting.clouds import first_in_voxels, voxel_thinned

FingertipMap = Callable[[np.ndarray], np.ndarray]
COVERAGE_RADII_MM = (5, 10, 15)
ROBOT_VOXEL = 0.003  # m
HUMAN_VOXEL = 0.001  # m
SMALL_STEP = 0.002  # m, step at which flatness and gain are measured
MIN_GAIN = 1e-6  # smaller gains are rounding errors of a finger that does not respond
APART_DISTANCE = 0.030  # m; human fingertips farther apart are not meant to pinch
DEEP_PINCH_DISTANCE = 0.004  # m; robot fingertips closer than this press into each other
PENETRATION = 0.002  # m; deeper penetrations count as self-collision


def motion_preservation(
    g: FingertipMap, frames: np.ndarray, rng: np.random.Generator, anchors: int = 4000
) -> float:
    """Returns the mean cosine between random steps of a human fingertip and the robot's steps.

    Anchors are whole recorded frames, uniform over the 1 mm voxels of the moved finger's cloud. Steps are
    uniform from 1 to 11 mm, directions uniform on the sphere. If the robot does not move, the cosine is 0.
    """
    cosines = []
    for finger in range(frames.shape[1]):
        x = frames[anchor_rows(frames[:, finger], anchors, rng)]
        d = directions(anchors, rng) * rng.uniform(0.001, 0.011, (anchors, 1))
        answer = moved(g, x, finger, d)[:, finger] - g(x)[:, finger]
        cosines.append(_cosines(d, answer))
    return float(np.mean(cosines))


def motion_preservation_track(frames: np.ndarray, p_BF: np.ndarray) -> float | None:
    """Returns the mean cosine of recorded steps longer than 1 mm; None if there are no such steps."""
    d, answer = np.diff(frames, axis=0), np.diff(p_BF, axis=0)
    long = np.linalg.norm(d, axis=-1) > 0.001
    means = [
        _cosines(d[long[:, i], i], answer[long[:, i], i]).mean()
        for i in range(d.shape[1])
        if long[:, i].any()
    ]
    return float(np.mean(means)) if means else None


def robot_voxels(p_BF: np.ndarray) -> list[np.ndarray]:
    """Returns for each finger the centres of the 3 mm voxels that its samples in p_BF (N, F, 3), m, hit."""
    tips = (voxel_thinned(p_BF[:, i], ROBOT_VOXEL) for i in range(p_BF.shape[1]))
    return [(np.floor(each / ROBOT_VOXEL) + 0.5) * ROBOT_VOXEL for each in tips]


def coverage(voxels: Sequence[np.ndarray], tips: Sequence[np.ndarray]) -> dict[str, float]:
    """Computes the mean share of a finger's voxels within 5, 10 and 15 mm of its tips, F arrays (T, 3), m."""
    farthest = 0.001 * max(COVERAGE_RADII_MM) + 1e-9
    shares = []
    for centres, points in zip(voxels, tips, strict=True):
        distance, _ = cKDTree(points).query(centres, distance_upper_bound=farthest)
        shares.append([(distance <= 0.001 * r).mean() for r in COVERAGE_RADII_MM])
    return {f"{r}mm": float(s) for r, s in zip(COVERAGE_RADII_MM, np.mean(shares, axis=0), strict=True)}


def cross_talk(g: FingertipMap, frames: np.ndarray, rng: np.random.Generator, anchors: int = 1000) -> float:
    """Returns mean motions of other robot fingertips over the own one's as a human tip moves by 5 mm."""
    fingers = frames.shape[1]
    if fingers == 1:
        return 0.0
    ratios = []
    for finger in range(fingers):
        x = frames[rng.integers(len(frames), size=anchors)]
        d = 0.005 * directions(anchors, rng)
        motion = np.linalg.norm(moved(g, x, finger, d) - g(x), axis=-1).mean(axis=0)
        others = (motion.sum() - motion[finger]) / (fingers - 1)
        ratios.append(others / motion[finger] if motion[finger] > 0 else (np.inf if others > 0 else 0.0))
    return float(np.mean(ratios))


def moved(g: FingertipMap, x: np.ndarray, finger: int, d: np.ndarray) -> np.ndarray:
    """Evaluates g at hands x (N, F, 3) with the tip of one finger displaced by d (N, 3), m."""
    hands = x.copy()
    hands[:, finger] += d
    return g(hands)


def directions(count: int, rng: np.random.Generator) -> np.ndarray:
    """Draws unit vectors (count, 3) uniformly on the sphere."""
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def anchor_rows(tips: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draws rows of tips (T, 3), m, such that every visited 1 mm voxel is equally likely."""
    return rng.choice(first_in_voxels(tips, HUMAN_VOXEL), size=count)


def _cosines(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    norms = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.where(norms > 0, (a * b).sum(-1) / np.where(norms > 0, norms, 1.0), 0.0)


def nearest_pairs(tips: np.ndarray, finger_names: Sequence[str]) -> np.ndarray:
    """Returns the numbers (T, 2) of the thumb and the finger nearest to it, of fingertips (T, F, 3)."""
    thumb, others = thumb_and_others(finger_names)
    nearest = np.linalg.norm(tips[:, others] - tips[:, [thumb]], axis=-1).argmin(axis=1)
    return np.stack([np.full(len(tips), thumb), np.array(others)[nearest]], axis=1)


def of_pairs(tips: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Selects from fingertips (T, F, 3) those of pairs (T, 2): (T, 2, 3)."""
    return tips[np.arange(len(tips))[:, None], pairs]


def pair_distances(tips: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Returns the distances (T,) of pairs (T, 2) of fingertips (T, F, 3); under `PINCH_M`, people pinch."""
    return np.linalg.norm(np.diff(of_pairs(tips, pairs), axis=1)[:, 0], axis=-1)


def average_over_context(g: FingertipMap, frames: np.ndarray, contexts: int = 12) -> list[np.ndarray]:
    """Computes for each finger the robot's tips averaged over postures of the other fingers: (M, 3) in B, m.

    One position per visited 1 mm voxel of a human fingertip is combined with the other fingertips of the
    frames in which the tip was nearest. This averages out positions that a coupled map reaches only through
    the other fingers.
    """
    count = min(contexts, len(frames))
    result = []
    for finger in range(frames.shape[1]):
        tips = voxel_thinned(frames[:, finger], HUMAN_VOXEL)
        _, rows = cKDTree(frames[:, finger]).query(tips, k=count)
        hands = frames[rows.ravel()]
        hands[:, finger] = np.repeat(tips, count, axis=0)
        result.append(g(hands)[:, finger].reshape(len(tips), count, 3).mean(axis=1))
    return result


def flatness_and_gain(
    g: FingertipMap, frames: np.ndarray, rng: np.random.Generator, anchors: int = 2000
) -> tuple[float, np.ndarray]:
    """Returns the mean squared second over first differences, and the gains (F, anchors), for 2 mm steps.

    The gain is the motion of a robot fingertip over that of the human fingertip.
    """
    flats, gains = [], []
    for finger in range(frames.shape[1]):
        x = frames[anchor_rows(frames[:, finger], anchors, rng)]
        d = SMALL_STEP * directions(anchors, rng)
        p_BF = g(x)[:, finger]
        ahead, behind = moved(g, x, finger, d)[:, finger], moved(g, x, finger, -d)[:, finger]
        first = np.linalg.norm(ahead - p_BF, axis=1)
        second = np.linalg.norm(ahead + behind - 2 * p_BF, axis=1)
        flats.append((second**2).mean() / max((first**2).mean(), 1e-18))
        gains.append(first / SMALL_STEP)
    return float(np.mean(flats)), np.stack(gains)


def gain_ratio(gains: np.ndarray) -> float | None:
    """Returns the 95th over the 5th percentile of the gains (F, anchors), averaged over fingers.

    Returns None if a finger does not respond to a twentieth of the steps.
    """
    low, high = np.percentile(gains, (5, 95), axis=1)
    return float((high / low).mean()) if low.min() > MIN_GAIN else None


def pinch(
    frames: np.ndarray, p_BF: np.ndarray, finger_names: Sequence[str], tip_radius: float
) -> dict | None:
    """Measures how well the robot's pinches reproduce the person's; None without a thumb or another finger.

    `closed`, `too_deep`, `mean_mm`, `p95_mm` and `frames` refer to a frame's nearest thumb–finger pair if it
    is under 15 mm apart (None without such frames), `all_pairs` to all pairs under 15 mm apart. `false` is
    the fraction of pairs over 30 mm apart whose robot fingertips touch, with centres within two tip radii.

    Args:
        frames: (T, F, 3) human fingertips, m.
        p_BF: (T, F, 3) robot fingertips, m.
        finger_names: names of the F fingers.
        tip_radius: radius of the robot's fingertips, m.
    """
    if "thumb" not in finger_names or len(finger_names) == 1:
        return None
    thumb, others = thumb_and_others(finger_names)
    human = np.linalg.norm(frames[:, others] - frames[:, [thumb]], axis=-1)
    robot = np.linalg.norm(p_BF[:, others] - p_BF[:, [thumb]], axis=-1)
    is_apart = human > APART_DISTANCE

    def figures(distance: np.ndarray) -> dict:
        if len(distance) == 0:
            return dict.fromkeys(("closed", "too_deep", "mean_mm", "p95_mm")) | {"frames": 0}
        return {
            "closed": float((distance <= 2 * tip_radius).mean()),
            "too_deep": float((distance < DEEP_PINCH_DISTANCE).mean()),
            "mean_mm": float(1000 * distance.mean()),
            "p95_mm": float(1000 * np.percentile(distance, 95)),
            "frames": len(distance),
        }

    pairs = nearest_pairs(frames, finger_names)
    nearest = pair_distances(p_BF, pairs)[pair_distances(frames, pairs) < PINCH_M]
    return figures(nearest) | {
        "false": float((robot[is_apart] <= 2 * tip_radius).mean()) if is_apart.any() else None,
        "all_pairs": figures(robot[human < PINCH_M]),
    }


def self_collision(hand: Hand, q: np.ndarray) -> dict[str, float]:
    """Returns the fractions of joint angles (T, n), rad, at which the hand collides.

    `deep` counts penetrations over 2 mm except between fingertips, `any` counts every contact.
    """
    touching = np.asarray(hand.collides(q), dtype=bool)
    deep = [
        any(depth > PENETRATION and not tip_tip for depth, _, _, tip_tip in hand.penetrations(row))
        for row in q[touching]
    ]
    return {"deep": sum(deep) / len(q), "any": float(touching.mean())}


def smoothness(q: np.ndarray, rate_hz: float) -> dict[str, float]:
    """Computes steps |Δq| per frame of the joint vector, rad, and the mean jerk |Δ³q| · rate³, rad/s³."""
    step = np.linalg.norm(np.diff(q, axis=0), axis=1)
    jerk = np.linalg.norm(np.diff(q, n=3, axis=0), axis=1) * rate_hz**3
    return {
        "mean": float(step.mean()),
        "p95": float(np.percentile(step, 95)),
        "max": float(step.max()),
        "jerk": float(jerk.mean()),
    }


def size(
    gains: np.ndarray, frames: np.ndarray, robot: np.ndarray, finger_names: Sequence[str]
) -> dict[str, float | dict[str, float]]:
    """Returns median gains of fingers, and their ratios to those of the affine fit.

    The affine fit scales each human fingertip's motion by the ratio of root mean square distances from the
    mean, of the robot's fingertip at uniform joint angles to the person's in the recording (`affine_ik`).

    Args:
        gains: (F, N) gains from `flatness_and_gain`.
        frames: (T, F, 3) human fingertips, m.
        robot: (N, F, 3) the robot's fingertips at uniform joint angles, m.
        finger_names: names of the F fingers.

    Returns:
        `median`: mean over fingers of the median gain; `over_affine`, `least_over_affine`: mean and smallest
        ratio to the affine fit's gain; `fingers`: name → median gain.
    """
    spreads = [np.sqrt(((p - p.mean(axis=0)) ** 2).sum(axis=-1).mean(axis=0)) for p in (robot, frames)]
    medians = np.median(gains, axis=1)
    ratios = medians * spreads[1] / spreads[0]
    return {
        "median": float(medians.mean()),
        "over_affine": float(ratios.mean()),
        "least_over_affine": float(ratios.min()),
        "fingers": dict(zip(finger_names, medians.tolist(), strict=True)),
    }


def posture(human: np.ndarray, robot: np.ndarray) -> dict[str, float]:
    """Returns angles between human and robot distal links (T, F, 3), degrees: `median` and `p90` over all."""
    median, p90 = np.percentile(np.degrees(angles_between(human, robot)), (50, 90))
    return {"median": float(median), "p90": float(p90)}


def angles_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns the angles (...), rad, between vectors (..., 3)."""
    norms = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.arccos(np.clip((a * b).sum(axis=-1) / np.maximum(norms, 1e-12), -1.0, 1.0))
