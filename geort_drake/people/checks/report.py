"""The health of a recording as a table of numbers, for people and for programs."""

from collections.abc import Sequence
from typing import Any

from geort_drake.people.checks import verdict
from geort_drake.people.checks.findings import Finding, Severity
from geort_drake.people.coverage import coverage
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.recording import PINCH_M, Recording
from geort_drake.people.summary import pinch_distances, summarize


def report(name: str, recording: Recording | None, findings: Sequence[Finding]) -> dict[str, Any]:
    """What is known of a recording, in JSON types; without its figures where it was refused.

    Args:
        name: the file.
        recording: as examined, or None where the file could not be read.
        findings: of the reader and of the checks.
    """
    unfit = any(finding.severity in (Severity.ERROR, Severity.UNFIT) for finding in findings)
    result: dict[str, Any] = {
        "file": name,
        "verdict": verdict(findings),
        "fit_for_training": not unfit,
        "findings": [
            {
                "check": finding.check,
                "severity": str(finding.severity),
                "what": finding.what,
                "where": finding.where,
                "advice": finding.advice,
                "lost_frames": len(finding.lost),
            }
            for finding in findings
        ],
    }
    if recording is not None and result["verdict"] != "refused":
        result |= _figures(recording)
    return result


def _figures(recording: Recording) -> dict[str, Any]:
    summary = summarize(recording)
    pinches = {finger: int((d < PINCH_M).sum()) for finger, d in pinch_distances(recording).items()}
    tracked = recording.metadata.get("wrist_position_tracked", True)
    pose = "none" if recording.X_WH is None else "pose" if tracked else "orientation"
    length, spread = 1e3 * summary.bone_length.reshape(5, 4), 100 * summary.bone_spread.reshape(5, 4)
    return {
        "format": recording.metadata.get("format", "geort_drake"),
        "side": recording.side,
        "recorded_side": recording.metadata.get("recorded_side"),
        "frames": len(recording),
        "valid_frames": int(recording.valid.sum()),
        "duration_s": recording.duration_s,
        "rate_hz": recording.rate_hz,
        "rate_known": bool(recording.metadata.get("rate_known", True)),
        "wrist": pose,
        "sha256": recording.digest,
        "fingers": {
            finger: {
                "bones_mm": length[i].tolist(),
                "bones_vary_percent": float(spread[i].max()),
                "speed_median_m_s": float(summary.speed_median[i]),
                "speed_p95_m_s": float(summary.speed_p95[i]),
                "pinch_frames": pinches.get(finger),
            }
            for i, finger in enumerate(FINGER_NAMES)
        },
        "coverage": [
            {
                "motion": motion.name,
                "seen": motion.seen,
                "wanted": motion.wanted,
                "unit": motion.unit,
                "enough": motion.enough,
            }
            for motion in coverage(recording)
        ],
    }
