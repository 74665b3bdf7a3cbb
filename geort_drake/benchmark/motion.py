"""Computes speeds and movements of a person's hand in a trial."""

import numpy as np

from geort_drake.people.keypoints import TIP_KEYPOINT
from geort_drake.people.recording import Recording

# Rate and cutoff of resampled positions, Hz; voluntary motion has no power beyond the cutoff.
_RATE_HZ, _CUTOFF_HZ = 50.0, 6.0
_MIN_DURATION_S = 1.0
# Speed below which the hand rests, m/s.
_REST_SPEED = 0.02
# Height and prominence that make a peak of the wrist's speed a movement, m/s.
_MIN_PEAK, _MIN_PROMINENCE = 0.05, 0.03
FIGURES = ("wrist_speed", "fingertip_speed", "movements")


def motion_of(recording: Recording) -> dict[str, float | None]:
    """Returns figures of a hand's motion while it was followed; None if that took less than a second.

    Returns:
        `wrist_speed`, and `fingertip_speed` of the fastest fingertip relative to the wrist: means while
        moving, m/s; `movements`: peaks of the wrist's speed; those beyond one per target are corrections.
    """
    from scipy.signal import find_peaks  # takes half a second

    valid = recording.valid
    if recording.X_WH is None or valid.sum() < 2 or np.ptp(recording.t[valid]) < _MIN_DURATION_S:
        return dict.fromkeys(FIGURES)
    t = recording.t[valid]
    wrist = _speeds(t, recording.X_WH[valid][:, None, 4:])[:, 0]
    tips = _speeds(t, recording.p_HK[valid][:, list(TIP_KEYPOINT.values())]).max(axis=1)
    peaks, _ = find_peaks(wrist, height=_MIN_PEAK, prominence=_MIN_PROMINENCE)
    return {
        "wrist_speed": _while_moving(wrist),
        "fingertip_speed": _while_moving(tips),
        "movements": float(len(peaks)),
    }


def _speeds(t: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Returns speeds (N, P), m/s, of points (T, P, 3), m, resampled at a fixed rate and smoothed."""
    from scipy.signal import butter, sosfiltfilt

    grid = np.arange(t[0], t[-1], 1.0 / _RATE_HZ)
    flat = points.reshape(len(t), -1)
    even = np.stack([np.interp(grid, t, column) for column in flat.T], axis=1)
    smooth = sosfiltfilt(butter(2, _CUTOFF_HZ, fs=_RATE_HZ, output="sos"), even, axis=0)
    velocity = np.gradient(smooth, 1.0 / _RATE_HZ, axis=0)
    return np.linalg.norm(velocity.reshape(len(grid), -1, 3), axis=2)


def _while_moving(speed: np.ndarray) -> float:
    moving = speed[speed > _REST_SPEED]
    return float(moving.mean()) if len(moving) else 0.0
