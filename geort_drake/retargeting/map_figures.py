"""Coverage and cross-talk of a map, which a training steers by and an evaluation reports.

Functions take g = FK∘f, "where do the robot's fingertips (N, F, 3) go for human fingertips (N, F, 3)",
in metres; randomness enters as a NumPy Generator.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial import cKDTree

from geort_drake.retargeting.clouds import voxel_centres

FingertipMap = Callable[[np.ndarray], np.ndarray]

COVERAGE_RADII_MM = (5, 10, 15)
ROBOT_SAMPLES = 200_000  # uniform in the joint angles, from which a C-space is made
ROBOT_VOXEL = 0.003  # m


def robot_voxels(p_BF: np.ndarray) -> list[np.ndarray]:
    """Per finger, the centres of the 3 mm voxels of its C-space that samples (N, F, 3) hit."""
    return [voxel_centres(p_BF[:, i], ROBOT_VOXEL) for i in range(p_BF.shape[1])]


def coverage(voxels: Sequence[np.ndarray], tips: Sequence[np.ndarray]) -> dict[str, float]:
    """Share of each finger's voxels within 5, 10 and 15 mm of where its tip goes, F arrays (T, 3)."""
    farthest = 0.001 * max(COVERAGE_RADII_MM) + 1e-9
    shares = []
    for centres, points in zip(voxels, tips, strict=True):
        distance, _ = cKDTree(points).query(centres, distance_upper_bound=farthest)
        shares.append([(distance <= 0.001 * r).mean() for r in COVERAGE_RADII_MM])
    return {f"{r}mm": float(s) for r, s in zip(COVERAGE_RADII_MM, np.mean(shares, axis=0), strict=True)}


def cross_talk(g: FingertipMap, frames: np.ndarray, rng: np.random.Generator, anchors: int = 1000) -> float:
    """Mean motion of the other robot fingertips over that of its own when one human tip moves by 5 mm."""
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
    """g where the tip of one finger of hands x (N, F, 3) is displaced by d (N, 3)."""
    hands = x.copy()
    hands[:, finger] += d
    return g(hands)


def directions(count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) unit vectors, uniform on the sphere."""
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)
