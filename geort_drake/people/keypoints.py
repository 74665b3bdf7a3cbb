"""The 21 keypoints of a human hand and the wrist frame H in which they are expressed.

Keypoints are numbered as in MediaPipe: wrist 0, thumb 1–4 (CMC, MCP, IP, tip),
then index 5–8, middle 9–12, ring 13–16 and little finger 17–20 (MCP, PIP, DIP, tip).

Frame H has its origin at the wrist. Its z axis points to the middle finger's MCP joint, y from the ring
to the index MCP joint (made orthogonal to z), and x = y × z out of the palm. A left hand is stored as its
mirror image (y negated), so for both sides the thumb is on the +y side and fingers flex towards +x.
"""

import numpy as np

FINGER_NAMES = ("thumb", "index", "middle", "ring", "little")
KEYPOINT_COUNT = 21
WRIST = 0
INDEX_MCP, MIDDLE_MCP, RING_MCP = 5, 9, 13

# The four keypoints of each finger, base to tip; thumb: CMC, MCP, IP, tip; others: MCP, PIP, DIP, tip.
FINGER_KEYPOINTS: dict[str, tuple[int, int, int, int]] = {
    name: (4 * i + 1, 4 * i + 2, 4 * i + 3, 4 * i + 4) for i, name in enumerate(FINGER_NAMES)
}
TIP_KEYPOINT: dict[str, int] = {name: keypoints[-1] for name, keypoints in FINGER_KEYPOINTS.items()}
BASE_KEYPOINT: dict[str, int] = {name: keypoints[0] for name, keypoints in FINGER_KEYPOINTS.items()}

# (parent, child), by finger, from the wrist to the tip.
BONES: list[tuple[int, int]] = [
    bone
    for keypoints in FINGER_KEYPOINTS.values()
    for bone in zip((WRIST, *keypoints[:-1]), keypoints, strict=True)
]


def wrist_pose(p_WK: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Computes the pose of the wrist frame H from the keypoints.

    Args:
        p_WK: (..., 21, 3) keypoints of a right hand (or a mirrored left one) in any frame W, m.

    Returns:
        R_WH (..., 3, 3) and p_WH (..., 3), m. R_WH is NaN where the wrist and the index, middle and ring
        knuckles do not span a plane.
    """
    p_WK = np.asarray(p_WK, dtype=float)
    p_WH = p_WK[..., WRIST, :]
    with np.errstate(invalid="ignore", divide="ignore"):
        z = _unit(p_WK[..., MIDDLE_MCP, :] - p_WH)
        across = p_WK[..., INDEX_MCP, :] - p_WK[..., RING_MCP, :]
        y = _unit(across - np.sum(across * z, axis=-1, keepdims=True) * z)
    x = np.cross(y, z)
    return np.stack([x, y, z], axis=-1), p_WH


def to_wrist_frame(p_WK: np.ndarray) -> np.ndarray:
    """Transforms keypoints p_WK (..., 21, 3), m, to p_HK in each frame's own wrist frame H."""
    R_WH, p_WH = wrist_pose(p_WK)
    # A row vector times R_WH is R_WH' times the column vector.
    return (np.asarray(p_WK, dtype=float) - p_WH[..., None, :]) @ R_WH


def mirrored(p: np.ndarray) -> np.ndarray:
    """Mirrors points p (..., 3) by negating y; left hands are stored this way."""
    return np.asarray(p) * np.array([1.0, -1.0, 1.0])


def bone_lengths(p_HK: np.ndarray) -> np.ndarray:
    """Computes the lengths (..., 20), m, of the `BONES` from keypoints p_HK (..., 21, 3) in any frame."""
    parents, children = np.array(BONES).T
    p_HK = np.asarray(p_HK, dtype=float)
    with np.errstate(invalid="ignore"):  # of lost frames, which may be infinite
        return np.linalg.norm(p_HK[..., children, :] - p_HK[..., parents, :], axis=-1)


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.where(length > 1e-9, v / length, np.nan)
