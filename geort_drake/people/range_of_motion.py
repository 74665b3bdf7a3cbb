"""How far the fingers of a recording moved, and which of their motions were too narrow to learn from."""

from collections.abc import Sequence

import numpy as np

from geort_drake.people.keypoints import FINGER_KEYPOINTS, WRIST

# The least range of each motion, deg, and how a person makes it. Half of the least that either of two
# recordings with gloves shows (GeoRT's of its author, MANUS subject 000): fingers bend by 175 to 272 and
# move sideways by 14 to 40, the thumb bends by 54 to 108, sweeps by 49 to 54 and lifts by 42 to 44.
_FINGER = {
    "bends": (90.0, "stretch it fully and close it to a fist"),
    "moves sideways": (7.0, "spread the fingers and close them"),
}
_THUMB = {
    "bends": (25.0, "stretch it fully and bend it into the palm"),
    "sweeps across the palm": (25.0, "move it to the little finger and back"),
    "lifts off the palm": (20.0, "move it away from the palm and back"),
}
_RIDGE = 0.01  # against the mean square of a bone's coordinate, which bending makes 0.1 and more


def wanted_motions(finger: str) -> dict[str, tuple[float, str]]:
    """Name of each motion of a finger, as in `ranges_deg` → its least range in deg, and how to make it."""
    return _THUMB if finger == "thumb" else _FINGER


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
        wanted = wanted_motions(finger)
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
    are those of the first bone that moves: of a finger sideways, out of the plane in which it bends; of the
    thumb its elevation over the x–z plane (across the palm) and over the y–z plane (off the palm).
    """
    chain = FINGER_KEYPOINTS[finger]
    thumb = finger == "thumb"
    bones = np.diff(np.asarray(p_HK, dtype=float)[:, chain if thumb else (WRIST, *chain)], axis=1)
    bones = bones / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-9)
    cosines = np.clip((bones[:, 1:] * bones[:, :-1]).sum(-1), -1.0, 1.0)
    first = np.clip(bones[:, 0 if thumb else 1], -1.0, 1.0)
    angles = {"bends": np.arccos(cosines).sum(axis=1)}
    if thumb:
        angles["sweeps across the palm"] = np.arcsin(first[:, 1])
        angles["lifts off the palm"] = np.arcsin(first[:, 0])
    else:
        angles["moves sideways"] = np.arcsin(_out_of_plane(first))
    return {name: float(np.rad2deg(np.ptp(np.percentile(angle, (1, 99))))) for name, angle in angles.items()}


def _out_of_plane(bones: np.ndarray) -> np.ndarray:
    """Sines (T,) of the angles of bones (T, 3), unit vectors, to the plane y = αx + βz that fits best.

    The fingers' planes converge by up to 9°, so bending alone changes a bone's elevation over the x–z plane.
    """
    xz, y = bones[:, [0, 2]], bones[:, 1]
    # The ridge keeps the plane upright where a finger hardly bends, or it would follow the motion sideways.
    slopes = np.linalg.solve(xz.T @ xz + _RIDGE * len(xz) * np.eye(2), xz.T @ y)
    return np.clip((y - xz @ slopes) / np.sqrt(1.0 + slopes @ slopes), -1.0, 1.0)
