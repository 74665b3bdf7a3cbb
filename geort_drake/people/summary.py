"""A recording in numbers: where the fingertips went, how fast, and how often they pinched."""

import dataclasses

import numpy as np

from geort_drake.people.keypoints import FINGER_NAMES, TIP_KEYPOINT, bone_lengths
from geort_drake.people.recording import PINCH_M, Recording


@dataclasses.dataclass(frozen=True, eq=False)
class Summary:
    """Statistics of the valid frames of one recording; tips in the order thumb ... little, frame H.

    Attributes:
        workspace: (5, 3, 2) 0.5th and 99.5th percentile of each tip coordinate, m.
        principal_std: (5, 3) standard deviations of each tip's cloud along its principal axes,
            largest first, m; the last one is the cloud's thickness.
        speed_median, speed_p95: (5,) of the tips' speeds relative to the wrist, m/s.
        pinch_share: (4,) share of frames with the thumb tip within 15 mm of index ... little.
        any_pinch_share: share of frames with at least one such pair.
        bone_length: (20,) median, in the order of `keypoints.BONES`, m.
        bone_spread: (20,) standard deviation over mean of the same.
    """

    workspace: np.ndarray
    principal_std: np.ndarray
    speed_median: np.ndarray
    speed_p95: np.ndarray
    pinch_share: np.ndarray
    any_pinch_share: float
    bone_length: np.ndarray
    bone_spread: np.ndarray


def summarize(recording: Recording) -> Summary:
    """Computes the statistics of a recording's valid frames (at least two)."""
    p_HF = recording.fingertips()
    lengths = bone_lengths(recording.p_HK[recording.valid])
    near = np.stack(list(pinch_distances(recording).values()), axis=1) < PINCH_M
    speed = fingertip_speeds(recording)
    covariance = np.stack([np.cov(p_HF[:, i].T) for i in range(5)])
    return Summary(
        workspace=np.moveaxis(np.percentile(p_HF, (0.5, 99.5), axis=0), 0, -1),
        principal_std=np.sqrt(np.linalg.eigvalsh(covariance)[:, ::-1].clip(0.0)),
        speed_median=np.median(speed, axis=0),
        speed_p95=np.percentile(speed, 95, axis=0),
        pinch_share=near.mean(axis=0),
        any_pinch_share=float(near.any(axis=1).mean()),
        bone_length=np.median(lengths, axis=0),
        bone_spread=lengths.std(axis=0) / lengths.mean(axis=0),
    )


def pinch_distances(recording: Recording) -> dict[str, np.ndarray]:
    """Distances (N,), m, of the thumb's tip to that of each other finger, in the N valid frames."""
    distance = tip_distances(recording.p_HK[recording.valid].astype(float))
    return dict(zip(FINGER_NAMES[1:], distance.T, strict=True))


def tip_distances(p_HK: np.ndarray) -> np.ndarray:
    """Distances (..., 4), m, of the thumb's tip to those of index ... little, of keypoints (..., 21, 3)."""
    p_HF = p_HK[..., list(TIP_KEYPOINT.values()), :]
    return np.linalg.norm(p_HF[..., 1:, :] - p_HF[..., :1, :], axis=-1)


def fingertip_speeds(recording: Recording) -> np.ndarray:
    """Speeds (N, 5), m/s, of the tips relative to the wrist, between neighbouring valid frames.

    Frames that repeat the one before exactly are dropped first: a recorder that polls faster than
    the glove delivers stores some frames twice, and would show a rest and then a jump.
    """
    fresh = np.concatenate([[True], np.any(np.diff(recording.p_HK, axis=0) != 0.0, axis=(1, 2))])
    kept = np.flatnonzero(fresh)
    both = recording.valid[kept[1:]] & recording.valid[kept[:-1]]
    p_HF = recording.p_HK[:, 4::4][kept].astype(float)
    return (np.linalg.norm(np.diff(p_HF, axis=0), axis=-1) / np.diff(recording.t[kept])[:, None])[both]
