"""GeoRT's .npy: (T, 21, 3) keypoints in MediaPipe's order, m, already in the wrist frame.

Source: https://github.com/facebookresearch/GeoRT, README (recording of human hands). There are no times.
"""

from typing import Any

import numpy as np

from geort_drake.gloves.formats.tracks import Tracks, numbers
from geort_drake.gloves.health.findings import Finding, Severity
from geort_drake.gloves.keypoints import KEYPOINT_COUNT, mirrored, to_wrist_frame

SUFFIXES = (".npy",)

_MOVED_M = 1e-3


def recognizes(contents: Any) -> bool:
    """Whether the array holds hands in their wrist frame, of either side."""
    data = contents["data"]
    if data.shape[1:] != (KEYPOINT_COUNT, 3) or data.dtype.kind not in "fiu":
        return False
    return min(_moved(data), _moved(mirrored(data))) < _MOVED_M


def read(name: str, contents: Any, side: str) -> Tracks:
    p_HK = numbers(name, "array", contents["data"], (KEYPOINT_COUNT, 3))
    moved = _moved(mirrored(p_HK) if side == "left" else p_HK)
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
    """How far keypoints are from the wrist frame, relative to a palm of 0.1, in whatever unit."""
    palm = np.nanmedian(np.linalg.norm(p[:, 9] - p[:, 0], axis=-1)) if len(p) else np.nan
    with np.errstate(invalid="ignore", divide="ignore"):
        return float(np.nanmax(np.abs(to_wrist_frame(p) - p), initial=0.0) * 0.1 / palm)
