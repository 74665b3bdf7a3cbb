"""Figures of maps for evaluations and trainings: motion, coverage and cross-talk.

g = FK∘f maps human fingertips (N, F, 3) to robot fingertips (N, F, 3), m. Random numbers come from a NumPy
Generator.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial import cKDTree

from geort_drake.retargeting.clouds import voxel_centres, voxel_index

FingertipMap = Callable[[np.ndarray], np.ndarray]

COVERAGE_RADII_MM = (5, 10, 15)
ROBOT_SAMPLES = 200_000  # uniform joint angles, whose fingertips sample the C-space
ROBOT_VOXEL = 0.003  # m
HUMAN_VOXEL = 0.001  # m


def motion_preservation(
    g: FingertipMap, frames: np.ndarray, rng: np.random.Generator, anchors: int = 4000
) -> float:
    """Returns the mean of `motion_cosines`."""
    return float(motion_cosines(g, frames, rng, anchors).mean())


def motion_cosines(
    g: FingertipMap, frames: np.ndarray, rng: np.random.Generator, anchors: int = 4000
) -> np.ndarray:
    """Computes cosines (F, anchors) between random steps of a human fingertip and the robot's steps.

    Anchors are whole recorded frames, uniform over the 1 mm voxels of the moved finger's cloud. Steps are
    uniform from 1 to 11 mm, directions uniform on the sphere. If the robot does not move, the cosine is 0.
    """
    cosines = []
    for finger in range(frames.shape[1]):
        x = frames[anchor_rows(frames[:, finger], anchors, rng)]
        d = directions(anchors, rng) * rng.uniform(0.001, 0.011, (anchors, 1))
        answer = moved(g, x, finger, d)[:, finger] - g(x)[:, finger]
        cosines.append(_cosines(d, answer))
    return np.stack(cosines)


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
    return [voxel_centres(p_BF[:, i], ROBOT_VOXEL) for i in range(p_BF.shape[1])]


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
    _, first = np.unique(voxel_index(tips, HUMAN_VOXEL), axis=0, return_index=True)
    return rng.choice(first, size=count)


def _cosines(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    norms = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.where(norms > 0, (a * b).sum(-1) / np.where(norms > 0, norms, 1.0), 0.0)
