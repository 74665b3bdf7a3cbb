"""Two figures as a related benchmark defines them, so that its readers can place ours.

The benchmark is mimic_retargeter_lab (https://github.com/mimicrobotics/mimic_retargeter_lab, July 2026,
its docs/workspace_metric.md and its motion preservation). They are not the paper's metrics of the same
names: the workspace counts joint samples instead of volume, and motion is compared along the recording
after each frame's hands have been laid on top of each other.
"""

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

WORKSPACE_RADIUS = 0.005  # m


def workspace(p_uniform: np.ndarray, p_BF: np.ndarray) -> float:
    """Share of uniform joint samples whose fingertip is within 5 mm of where the trajectory's tip went.

    Args:
        p_uniform: (N, F, 3) fingertips of uniformly drawn joint angles, m; theirs are a million.
        p_BF: (T, F, 3) fingertips along the trajectory, m.
    """
    shares = []
    for finger in range(p_BF.shape[1]):
        distance, _ = cKDTree(p_BF[:, finger]).query(
            p_uniform[:, finger], distance_upper_bound=2 * WORKSPACE_RADIUS
        )
        shares.append((distance <= WORKSPACE_RADIUS).mean())
    return float(np.mean(shares))


def aligned_motion_preservation(p_HL: np.ndarray, p_BL: np.ndarray) -> float:
    """Mean cosine of a fingertip's successive displacements after aligning the hands frame by frame.

    In every frame the similarity transform (rotation, scale, translation) that brings the human's
    landmarks nearest to the robot's in least squares is applied to the human's fingertips. Every step
    counts, however short; one without motion counts 0. Their landmarks are wrist, finger bases and
    tips; here they are bases and tips, as a hand description knows no wrist.

    Args:
        p_HL: (T, 2F, 3) the human's finger bases, then fingertips, m.
        p_BL: (T, 2F, 3) the robot's, in the same order, m.
    """
    tips = p_HL.shape[1] // 2
    p_HC, p_BC = p_HL.mean(axis=1, keepdims=True), p_BL.mean(axis=1, keepdims=True)
    human, robot = p_HL - p_HC, p_BL - p_BC
    turned = np.stack([Rotation.align_vectors(b, a)[0].apply(a) for a, b in zip(human, robot, strict=True)])
    # Least squares give the scale once the rotation is known (Umeyama 1991).
    scale = (turned * robot).sum((1, 2)) / (turned**2).sum((1, 2))
    aligned = scale[:, None, None] * turned + p_BC
    a, b = np.diff(aligned[:, tips:], axis=0), np.diff(p_BL[:, tips:], axis=0)
    norms = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    moved = norms > 1e-12  # m²: less is rounding
    return float(np.where(moved, (a * b).sum(-1) / np.where(moved, norms, 1.0), 0.0).mean())
