"""Reads recordings in any known format, transforms them to the wrist frame and checks them.

Faults that can be repaired without guessing are repaired and reported; unusable frames become invalid. A
file is refused only if its meaning is ambiguous or too little of it is usable.
"""

import dataclasses
import os
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from geort_drake.errors import RecordingError, UnknownNameError
from geort_drake.people.checks import examine, refuse, with_warnings
from geort_drake.people.checks.anatomy import UNITS_M
from geort_drake.people.checks.findings import Finding, warning
from geort_drake.people.formats import AUTO, FORMATS, choose
from geort_drake.people.formats.files import load
from geort_drake.people.formats.source import NO_HAND, Source, Tracks
from geort_drake.people.keypoints import mirrored, to_wrist_frame, wrist_pose
from geort_drake.people.recording import SIDES, Recording
from geort_drake.people.recording_parts import read_parts
from geort_drake.people.repairs import repaired_poses, repaired_times

# For files without timestamps. At 30 Hz, GeoRT's recording has fingertip speeds (99th percentile 1 m/s) that
# agree with gloves whose rate is known.
ASSUMED_RATE_HZ = 30.0

_COINCIDENT_M = 1e-6  # a frame whose keypoints are all this close together shows no hand
_MIN_UNIX_TIME_S = 1e8  # in 1973; later times are Unix times, smaller ones count from the device's start


def read_recording(
    path: str | os.PathLike,
    side: str = "right",
    training: bool = False,
    format: str = AUTO,
    unit: str | None = None,
    rate_hz: float | None = None,
) -> Recording:
    """Reads and checks a recording in any known format.

    Args:
        path: a file, or HO-3D's folder `meta`.
        side: "right" or "left"; a left hand is mirrored (see `keypoints`). It must agree with the side that
            the file states, if any.
        training: also requires 300 valid frames and at least one pinch.
        format: a name of `FORMATS`; "auto" detects it from the contents.
        unit: unit of lengths in the file, "m", "cm", "mm" or "inch"; by default the format's.
        rate_hz: frames per second of a file without timestamps; by default 30.

    Returns:
        The recording. Unusable frames are invalid; `metadata["warnings"]` lists faults and repairs.

    Raises:
        RecordingError: the file is missing, malformed or contains no plausible hand of that side.
        UnknownNameError: there is no such side, format or unit.
    """
    recording, findings = open_recording(path, side, format, unit, rate_hz)
    refuse(str(path), findings, training)
    recording, found = examine(recording)
    refuse(str(path), found, training)
    return with_warnings(recording, [*findings, *found])


def open_recording(
    path: str | os.PathLike,
    side: str = "right",
    format: str = AUTO,
    unit: str | None = None,
    rate_hz: float | None = None,
) -> tuple[Recording, list[Finding]]:
    """Reads and repairs a recording without checking it; arguments and errors are those of `read_recording`.

    Returns:
        The recording, with the format in `metadata["format"]`, and its faults and repairs. If too many
        frames are lost, one of them is an error.
    """
    path = Path(path)
    for kind, given, choices in (("side", side, SIDES), ("unit", unit, UNITS_M)):
        if given is not None and given not in choices:
            raise UnknownNameError(kind, given, choices)
    if (unfinished := read_parts(path)) is not None:
        _require_side(path, unfinished.side, side)
        return unfinished, []
    source = load(path)
    chosen = choose(path, source.contents, format)
    read = FORMATS[chosen].read(source, side)
    _require_side(path, read.side, side)
    if isinstance(read, Recording):
        if unit not in (None, "m"):
            raise RecordingError(f"{path}: geort-drake's own files are in metres, not in {unit}")
        recording = _repaired(source, read)
    else:
        metadata = {"side": side, "source": path.name, "format": chosen, "unit": unit or read.unit}
        recording = _recording(source, read, metadata, rate_hz)
    return recording, source.findings


def _repaired(source: Source, recording: Recording) -> Recording:
    """Repairs times and quaternions of a recording from geort-drake's own file."""
    count, X_WH = len(recording), recording.X_WH
    t = repaired_times(recording.t, np.arange(count), source.faults)
    if X_WH is not None:
        X_WH, findings = repaired_poses(X_WH, recording.valid, source.faults)
        source.findings.extend(findings)
    source.findings.extend(source.faults.findings(count))
    valid = recording.valid & source.faults.valid(count)
    return dataclasses.replace(recording, t=t, X_WH=X_WH, valid=valid)


def _recording(source: Source, tracks: Tracks, metadata: dict, rate_hz: float | None) -> Recording:
    """Makes a recording in H with times from 0; adds faults and repairs to the source's findings."""
    p_WK, t, faults = UNITS_M[metadata["unit"]] * tracks.p_WK, tracks.t, source.faults
    count = len(p_WK)
    with np.errstate(invalid="ignore"):
        empty = np.ptp(p_WK, axis=1).max(axis=1, initial=0.0) < _COINCIDENT_M
    faults.add(NO_HAND, np.flatnonzero(empty), "all keypoints are in one place")
    p_WK[empty] = np.nan
    numbers = np.arange(count)
    metadata["rate_known"] = t is not None or rate_hz is not None
    if t is not None:
        numbers = _without_duplicates(source, p_WK, t)
        t = repaired_times(t[numbers], numbers, faults)
    else:
        t = numbers / (rate_hz or ASSUMED_RATE_HZ)
    if not metadata["rate_known"]:
        what = f"no timestamps: {ASSUMED_RATE_HZ:g} Hz assumed"
        source.findings.append(warning("timestamps", what, advice="if you know better, convert with --rate"))
    if len(t) and t[0] > _MIN_UNIX_TIME_S:
        metadata["start_time_unix_s"] = float(t[0])
    p_VK = mirrored(p_WK) if metadata["side"] == "left" else p_WK
    with np.errstate(invalid="ignore", over="ignore"):
        p_HK = to_wrist_frame(p_VK)
    flat = np.isfinite(p_WK).all(axis=(1, 2)) & ~np.isfinite(p_HK).all(axis=(1, 2))
    faults.add("have no palm plane", np.flatnonzero(flat), "keypoints 0, 5, 9, 13 coincide or lie on a line")
    source.findings.extend(faults.findings(count))
    valid = faults.valid(count)[numbers]
    p_VK, p_HK, X_WH = p_VK[numbers], p_HK[numbers], None
    if tracks.world:
        known = np.isfinite(p_HK).all(axis=(1, 2))
        X_WH = _wrist_poses(p_VK, known)
        travel = np.abs(X_WH[known & valid, 4:] - X_WH[known & valid, 4:][:1]).max(initial=0.0)
        # A glove without a tracker measures the wrist's orientation, but not its position.
        metadata["wrist_position_tracked"] = bool(travel > 1e-3)
    return Recording(t - t[:1], p_HK, valid, X_WH, metadata)


def _wrist_poses(p_WK: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Computes wrist poses X_WH (T, 7) from keypoints; frames that are not `known` get no rotation."""
    R_WH, p_WH = wrist_pose(p_WK)
    if not len(p_WH):
        return np.empty((0, 7))  # SciPy 1.15 accepts no empty array
    # Where squares overflow, the rotation is unknown as well.
    has_rotation = known & (np.linalg.det(np.nan_to_num(R_WH)) > 0.5)
    R_WH = np.where(has_rotation[:, None, None], R_WH, np.eye(3))
    quaternions = Rotation.from_matrix(R_WH).as_quat(scalar_first=True)
    # Signs are chosen so that neighbouring quaternions are close and can be interpolated.
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
    signs = np.where(np.concatenate([[0], np.cumsum(flips)]) % 2, -1.0, 1.0)
    return np.concatenate([quaternions * signs[:, None], p_WH], axis=1)


def _without_duplicates(source: Source, p_WK: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Returns the numbers of the frames that do not repeat the one before in time and keypoints."""
    same = np.diff(t, prepend=np.nan) == 0
    same[1:] &= ((p_WK[1:] == p_WK[:-1]) | np.isnan(p_WK[1:])).all(axis=(1, 2))
    if same.any():
        first = int(np.argmax(same))
        what = f"{int(same.sum())} of {len(t)} frames are stored twice with the same time"
        source.findings.append(warning("duplicated frames", what, f"t[{first}]", "left out"))
    return np.flatnonzero(~same)


def _require_side(path: Path, given: str | None, expected: str) -> None:
    if given is not None and given != expected:
        raise RecordingError(
            f"{path}: the file contains a {given} hand, a {expected} one was requested; give --side {given} "
            f"or a {given} robot hand, or convert it with --side {given} --mirror"
        )
