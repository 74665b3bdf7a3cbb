"""How far the fingers of a recording moved, and which of their motions were too narrow to learn from."""

from collections.abc import Sequence

import numpy as np

from geort_drake.gloves.keypoints import FINGER_KEYPOINTS, WRIST

# The least range of each motion, deg, and how a person makes it. Half of the least that either of two
# recordings with gloves shows (GeoRT's of its author, MANUS subject 000): fingers bend by 175 to 272 and
# move sideways by 16 to 56, the thumb bends by 54 to 108, sweeps by 49 to 54 and lifts by 42 to 44.
_FINGER = {
    "bends": (90.0, "stretch it fully and close it to a fist"),
    "moves sideways": (8.0, "spread the fingers and close them"),
}
_THUMB = {
    "bends": (25.0, "stretch it fully and bend it into the palm"),
    "sweeps across the palm": (25.0, "move it to the little finger and back"),
    "lifts off the palm": (20.0, "move it away from the palm and back"),
}


def narrow_motions(p_HK: np.ndarray, keypoints: Sequence[int]) -> list[str]:
    """Sentences about the motions that a recording holds too little of; none where there is enough.

    Args:
        p_HK: (T, 21, 3) keypoints in H, m, of valid frames.
        keypoints: those of the fingertips that are to be learned from; others name no finger.
    """
    lacking = []
    for finger, chain in FINGER_KEYPOINTS.items():
        if chain[-1] not in keypoints:
            continue
        wanted = _THUMB if finger == "thumb" else _FINGER
        tip = 1000 * np.ptp(np.percentile(p_HK[:, chain[-1]], (1, 99), axis=0), axis=0)
        for motion, degrees in ranges_deg(p_HK, finger).items():
            least, advice = wanted[motion]
            if degrees < least:
                lacking.append(
                    f"the recording's {finger} {motion} by only {degrees:.0f}°, at least {least:.0f}° are "
                    f"wanted (its tip stays within {tip[0]:.0f} × {tip[1]:.0f} × {tip[2]:.0f} mm in and out "
                    f"of the palm, sideways and lengthwise): {advice}"
                )
    return lacking


def ranges_deg(p_HK: np.ndarray, finger: str) -> dict[str, float]:
    """1st to 99th percentile of each of a finger's motions, deg, from keypoints p_HK (T, 21, 3) in H, m.

    Bending is the sum of the angles between successive bones, from the metacarpal on; the other motions
    are those of the first bone that moves, its elevation over the x–z plane (sideways, across the palm)
    and, of the thumb, over the y–z plane (off the palm).
    """
    chain = FINGER_KEYPOINTS[finger]
    thumb = finger == "thumb"
    bones = np.diff(np.asarray(p_HK, dtype=float)[:, chain if thumb else (WRIST, *chain)], axis=1)
    bones = bones / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-9)
    cosines = np.clip((bones[:, 1:] * bones[:, :-1]).sum(-1), -1.0, 1.0)
    first = np.clip(bones[:, 0 if thumb else 1], -1.0, 1.0)
    angles = {"bends": np.arccos(cosines).sum(axis=1)}
    angles["sweeps across the palm" if thumb else "moves sideways"] = np.arcsin(first[:, 1])
    if thumb:
        angles["lifts off the palm"] = np.arcsin(first[:, 0])
    return {name: float(np.rad2deg(np.ptp(np.percentile(angle, (1, 99))))) for name, angle in angles.items()}
