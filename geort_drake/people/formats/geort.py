"""GeoRT's .npy: (T, 21, 3) keypoints in MediaPipe's order, m, already in the wrist frame.

Source: https://github.com/facebookresearch/GeoRT, README (recording of human hands). There are no times.
"""

from typing import Any

import numpy as np

from geort_drake.people.checks.findings import Finding, Severity
from geort_drake.people.formats.tracks import Tracks, numbers
from geort_drake.people.keypoints import KEYPOINT_COUNT, mirrored, to_wrist_frame

SUFFIXES = (".npy",)

_MOVED_M = 1e-3


def recognizes(contents: Any) -> bool:
    """Whether the array holds hands in their wrist frame, of either side."""
    data = contents["data"]
    return data.shape[1:] == (KEYPOINT_COUNT, 3) and data.dtype.kind in "fiu" and _moved(data) < _MOVED_M


def read(name: str, contents: Any, side: str) -> Tracks:
    p_HK = numbers(name, "array", contents["data"], (KEYPOINT_COUNT, 3))
    moved = _moved(p_HK)
    findings = []
    if moved > _MOVED_M:
        findings.append(
            Finding(
                "axes",
                Severity.WARNING,
                f"not given in the wrist frame: moved by up to {1e3 * moved:.0f} mm to get there",
                "array",
            )
        )
    return Tracks(p_HK, findings=findings)


def _moved(p: np.ndarray) -> float:
    """How far keypoints are from the wrist frame of either side, relative to a palm of 0.1, in any unit."""
    known = p[np.isfinite(p).all(axis=(1, 2))]
    if not len(known):
        return np.inf
    palm = max(float(np.median(np.linalg.norm(known[:, 9] - known[:, 0], axis=-1))), 1e-12)
    off = min(np.nanmax(np.abs(to_wrist_frame(q) - q), initial=0.0) for q in (known, mirrored(known)))
    return float(off * 0.1 / palm)
