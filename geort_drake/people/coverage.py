"""Measures how well a recording covers the motion that training needs: ranges, pinches, speeds."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from geort_drake.people.keypoints import FINGER_KEYPOINTS, FINGER_NAMES, TIP_KEYPOINT, WRIST, bone_lengths
from geort_drake.people.recording import PINCH_M, Recording

# The required range of each motion, deg, and how to make it. It is half of the smaller range in two glove
# recordings (that of GeoRT's authors, and MANUS subject 000).
_FINGER_MOTIONS = {
    "bends": (90.0, "stretch it fully and close it to a fist"),
    "moves sideways": (7.0, "spread the fingers and close them"),
}
_THUMB_MOTIONS = {
    "bends": (25.0, "stretch it fully and bend it into the palm"),
    "sweeps across the palm": (25.0, "move it to the little finger and back"),
    "lifts off the palm": (20.0, "move it away from the palm and back"),
}
# Required pinches per finger. People who are asked to pinch do so more than ten times in five minutes.
PINCHES = 5
_TRAINING_FRAMES = 300
_RELEASE_M = 1.5 * PINCH_M  # a pinch ends at this distance; the hysteresis ignores jitter
_RIDGE = 0.01  # of the ridge regression; the mean square of a bending bone's coordinate exceeds 0.1


# A motion that training needs, as JSON: `motion`, its name; the amounts `seen` and `required`, in `unit`:
# "°" of range or "times"; whether that is `enough`; and `advice` on how to make it.
Motion = dict[str, Any]


def _motion(name: str, value: float, minimum: float, unit: str, advice: str) -> Motion:
    amounts = {"seen": value, "required": minimum, "unit": unit, "enough": value >= minimum}
    return {"motion": name, **amounts, "advice": advice}


def describe(motion: Motion) -> str:
    """Returns the amounts of a motion in words, rounded down: 6.9 of 7 degrees are not enough."""
    return "{motion}: {0} {unit}, required {required:.0f}".format(int(motion["seen"]), **motion)


def coverage(recording: Recording) -> list[Motion]:
    """Measures every motion that training needs: the ranges of the fingers, then the pinches.

    Args:
        recording: a recording with at least one valid frame.
    """
    motions = finger_motions(recording.p_HK[recording.valid])
    for finger, distance in pinch_distances(recording).items():
        advice = f"pinch thumb and {finger} at different places"
        motions.append(_motion(f"thumb pinches {finger}", pinches(distance), PINCHES, "times", advice))
    return motions


def training_faults(recording: Recording) -> list[str]:
    """Returns sentences about what makes a recording unfit for training; none if it is fit."""
    faults, valid = [], int(recording.valid.sum())
    if valid < _TRAINING_FRAMES:
        faults.append(
            f"{valid} valid frames, training needs at least {_TRAINING_FRAMES}; record five minutes"
        )
    if all(distance.min() >= PINCH_M for distance in pinch_distances(recording).values()):
        faults.append(
            f"the thumb never comes within {1e3 * PINCH_M:.0f} mm of a finger (p_HK); pinch each finger a "
            "few times while recording"
        )
    return faults


def finger_motions(p_HK: np.ndarray, keypoints: Sequence[int] = tuple(TIP_KEYPOINT.values())) -> list[Motion]:
    """Measures the ranges of the fingers' motions, each from its 1st to its 99th percentile.

    Bending is the sum of the angles between successive bones, from the metacarpal on. The other motions are
    those of the first moving bone: for a finger, sideways out of the plane in which it bends; for the thumb,
    its elevation over the x-z plane (across the palm) and over the y-z plane (off the palm).

    Args:
        p_HK: (T, 21, 3) keypoints in H, m, of valid frames.
        keypoints: the fingertips whose fingers are measured; other keypoints are ignored.
    """
    motions = []
    for finger in (finger for finger, tip in TIP_KEYPOINT.items() if tip in keypoints):
        thumb, chain = finger == "thumb", FINGER_KEYPOINTS[finger]
        bones = np.diff(np.asarray(p_HK, dtype=float)[:, chain if thumb else (WRIST, *chain)], axis=1)
        bones = bones / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-9)
        cosines = np.clip((bones[:, 1:] * bones[:, :-1]).sum(-1), -1.0, 1.0)
        first = np.clip(bones[:, 0 if thumb else 1], -1.0, 1.0)
        sines = (first[:, 1], first[:, 0]) if thumb else (_out_of_plane(first),)
        angles = (np.arccos(cosines).sum(axis=1), *map(np.arcsin, sines))
        motions_of = _THUMB_MOTIONS if thumb else _FINGER_MOTIONS
        for angle, (name, (least, advice)) in zip(angles, motions_of.items(), strict=True):
            span = float(np.rad2deg(np.ptp(np.percentile(angle, (1, 99)))))
            motions.append(_motion(f"{finger} {name}", span, least, "°", advice))
    return motions


def _out_of_plane(bones: np.ndarray) -> np.ndarray:
    """Computes sines (T,) of the angles between unit vectors (T, 3) and their best-fitting plane y = αx + βz.

    The fingers' planes converge by up to 9°, so bending alone changes a bone's elevation over the x-z plane.
    """
    xz, y = bones[:, [0, 2]], bones[:, 1]
    # Where a finger hardly bends, the ridge keeps the plane from following its sideways motion.
    slopes = np.linalg.solve(xz.T @ xz + _RIDGE * len(xz) * np.eye(2), xz.T @ y)
    return np.clip((y - xz @ slopes) / np.sqrt(1.0 + slopes @ slopes), -1.0, 1.0)


def pinches(distance: np.ndarray) -> int:
    """Counts how often tips at `distance` (N,), m, come together after being apart."""
    # +1 where tips touch, -1 where they are apart; between the thresholds, the last state stays.
    state = np.where(distance < PINCH_M, 1, np.where(distance > _RELEASE_M, -1, 0))
    state = np.append(-1, state[state != 0])
    return int((np.diff(state) > 0).sum())


def pinch_distances(recording: Recording) -> dict[str, np.ndarray]:
    """Returns distances (N,), m, from the thumb's tip to each other fingertip, in the N valid frames."""
    distance = tip_distances(recording.p_HK[recording.valid].astype(float))
    return dict(zip(FINGER_NAMES[1:], distance.T, strict=True))


def tip_distances(p_HK: np.ndarray) -> np.ndarray:
    """Computes distances (..., 4), m, from the thumb's tip to those of index to little, p_HK (..., 21, 3)."""
    p_HF = p_HK[..., list(TIP_KEYPOINT.values()), :]
    return np.linalg.norm(p_HF[..., 1:, :] - p_HF[..., :1, :], axis=-1)


def fingertip_speeds(recording: Recording) -> np.ndarray:
    """Computes speeds (N, 5), m/s, of the tips relative to the wrist, between neighbouring valid frames.

    Repeated frames are dropped first: a recorder that polls faster than the glove delivers stores some frames
    twice, which would look like a rest followed by a jump.
    """
    is_new = np.concatenate([[True], np.any(np.diff(recording.p_HK, axis=0) != 0.0, axis=(1, 2))])
    new_rows = np.flatnonzero(is_new)
    is_valid = recording.valid[new_rows[1:]] & recording.valid[new_rows[:-1]]
    p_HF = recording.p_HK[:, 4::4][new_rows].astype(float)
    return (np.linalg.norm(np.diff(p_HF, axis=0), axis=-1) / np.diff(recording.t[new_rows])[:, None])[
        is_valid
    ]


def figures(recording: Recording) -> dict[str, Any]:
    """Returns the figures of a checked recording for reports, of JSON types; units are in the names."""
    lengths = bone_lengths(recording.p_HK[recording.valid])
    speed = fingertip_speeds(recording)
    tracked = recording.metadata.get("wrist_position_tracked", True)
    return {
        "format": recording.metadata.get("format", "geort_drake"),
        "side": recording.side,
        "recorded_side": recording.metadata.get("recorded_side"),
        "frames": len(recording),
        "valid_frames": int(recording.valid.sum()),
        "duration_s": recording.duration_s,
        "rate_hz": recording.rate_hz,
        "rate_known": bool(recording.metadata.get("rate_known", True)),
        "wrist": "none" if recording.X_WH is None else "pose" if tracked else "orientation",
        "sha256": recording.digest,
        "fingers": {
            finger: {
                "bones_mm": bones.tolist(),
                "bones_vary_percent": float(spread.max()),
                "speed_median_m_s": float(np.median(of_tip)),
                "speed_p95_m_s": float(np.percentile(of_tip, 95)),
                "pinch_frames": None if distance is None else int((distance < PINCH_M).sum()),
            }
            for finger, bones, spread, of_tip, distance in zip(
                FINGER_NAMES,
                1e3 * np.median(lengths, axis=0).reshape(5, 4),
                100 * (lengths.std(axis=0) / lengths.mean(axis=0)).reshape(5, 4),
                speed.T,
                (None, *pinch_distances(recording).values()),
                strict=True,
            )
        },
        "coverage": coverage(recording),
    }
