"""Checks of recordings: one small function each."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator

from geort_drake.errors import RecordingError
from geort_drake.people.checks import anatomy, motion, timing
from geort_drake.people.checks.findings import Finding, Severity
from geort_drake.people.recording import Recording

# In order: each check relies on those before it.
CHECKS: tuple[Callable[[Recording], Iterator[Finding]], ...] = (
    timing.check_clock,
    timing.check_lost,
    anatomy.check_order,
    anatomy.check_unit,
    anatomy.check_side,
    motion.check_spikes,
    anatomy.check_bones,
    anatomy.check_frame,
    timing.check_dropped,
    timing.check_repeats,
    motion.check_jumps,
    motion.check_frozen,
    motion.check_training,
)


def examine(recording: Recording) -> tuple[Recording, list[Finding]]:
    """Runs all checks on a recording in frame H, up to the first error.

    Returns:
        The recording with unusable frames marked invalid, and the findings.
    """
    findings: list[Finding] = []
    for check in CHECKS:
        for finding in check(recording):
            findings.append(finding)
            if finding.lost:
                valid = recording.valid.copy()
                valid[list(finding.lost)] = False
                recording = dataclasses.replace(recording, valid=valid)
        if verdict(findings) == "refused":
            break
    return recording, findings


def refuse(name: str, findings: Iterable[Finding], training: bool = False) -> None:
    """Raises RecordingError for the first finding that forbids use, or training if `training` is set."""
    fatal = (Severity.ERROR, Severity.UNFIT) if training else (Severity.ERROR,)
    for finding in findings:
        if finding.severity in fatal:
            raise RecordingError(f"{name}: {finding}")


def with_warnings(recording: Recording, findings: Iterable[Finding]) -> Recording:
    """Returns the recording with all findings added to `metadata["warnings"]`, each once."""
    warnings = list(dict.fromkeys([*recording.metadata.get("warnings", []), *map(str, findings)]))
    return dataclasses.replace(recording, metadata={**recording.metadata, "warnings": warnings})


def verdict(findings: Iterable[Finding]) -> str:
    """Returns "usable", "usable with warnings" or "refused"."""
    severities = {finding.severity for finding in findings}
    if Severity.ERROR in severities:
        return "refused"
    return "usable with warnings" if severities else "usable"
