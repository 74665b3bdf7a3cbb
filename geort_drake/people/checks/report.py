"""Reports the health of a recording as JSON: verdict, findings and figures."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from geort_drake.people.checks import verdict
from geort_drake.people.checks.findings import Finding, Severity
from geort_drake.people.coverage import coverage, fingertip_speeds, pinch_distances
from geort_drake.people.keypoints import FINGER_NAMES, bone_lengths
from geort_drake.people.recording import PINCH_M, Recording


def report(name: str, recording: Recording | None, findings: Sequence[Finding]) -> dict[str, Any]:
    """Returns the verdict, the findings and, unless the recording was refused, its figures.

    Args:
        name: name of the file.
        recording: the examined recording, or None if the file could not be read.
        findings: those of the reader and of the checks.
    """
    unfit = any(finding.severity in (Severity.ERROR, Severity.UNFIT) for finding in findings)
    result: dict[str, Any] = {
        "file": name,
        "verdict": verdict(findings),
        "fit_for_training": not unfit,
        "findings": [
            {key: str(getattr(finding, key)) for key in ("check", "severity", "what", "where", "advice")}
            | {"lost_frames": len(finding.lost)}
            for finding in findings
        ],
    }
    if recording is not None and result["verdict"] != "refused":
        result |= _figures(recording)
    return result


def _figures(recording: Recording) -> dict[str, Any]:
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
        "coverage": [
            {"motion": motion.name, "seen": motion.seen, "required": motion.required, "unit": motion.unit}
            | {"enough": motion.enough}
            for motion in coverage(recording)
        ],
    }
