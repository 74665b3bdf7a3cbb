"""Reads recordings in any known format, transforms them to the wrist frame and checks them.

Faults that can be repaired without guessing are repaired and reported; unusable frames become invalid. A
file is refused only if its meaning is ambiguous or too little of it is usable.
"""

import bisect
import dataclasses
import os
from pathlib import Path

import numpy as np

from geort_drake.errors import RecordingError, UnknownNameError, naming
from geort_drake.people.checks import MAX_LOST, UNITS_M, examine, require_wrist_frame_hand
from geort_drake.people.coverage import training_faults
from geort_drake.people.formats import FORMATS, TIME_FIELDS, File, Track, load, unread_clock
from geort_drake.people.recording import SIDES, Recording

# For files without timestamps. At 30 Hz, GeoRT's recording has fingertip speeds (99th percentile 1 m/s) that
# agree with gloves whose rate is known.
ASSUMED_RATE_HZ = 30.0
AUTO, OWN = "auto", "geort_drake"

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
        path: a file.
        side: "right" or "left"; a left hand is mirrored (see `keypoints`). It must agree with the side that
            the file states, if any.
        training: also requires 300 valid frames and at least one pinch.
        format: a name of `FORMATS`, or "geort_drake" for the package's own; "auto" detects it.
        unit: unit of lengths in the file, "m", "dm", "cm", "mm" or "inch"; by default the format's.
        rate_hz: frames per second of a file without timestamps; by default 30.

    Returns:
        The recording. Unusable frames are invalid; `metadata["warnings"]` lists faults and repairs.

    Raises:
        RecordingError: the file is missing, malformed or contains no plausible hand of that side.
        UnknownNameError: there is no such side, format or unit.
    """
    path = Path(path)
    names = {"side": SIDES, "unit": UNITS_M, "format": (AUTO, OWN, *FORMATS)}
    for kind, name in (("side", side), ("unit", unit), ("format", format)):
        if name is not None and name not in names[kind]:
            raise UnknownNameError(kind, name, names[kind])
    with naming(path, RecordingError):
        file = load(path)
        is_own = format == OWN or (format == AUTO and "p_HK" in file.fields)
        if not is_own:
            recording = _read_foreign(path, file, side, format, unit, rate_hz)
        elif unit not in (None, "m"):
            raise RecordingError(f"geort-drake's own files are in metres, not in {unit}")
        else:
            recording = Recording.from_arrays(file.fields)
        if (stated := recording.side) != side:
            raise RecordingError(
                f"the file contains a {stated} hand, a {side} one was requested; give --side {stated} or a "
                f"{stated} robot hand, or mirror it: geort-drake recording convert FILE --side {stated} "
                "--mirror --output NEW.npz"
            )
        if is_own and recording.valid.any():  # of other files, the wrist frame is computed here
            require_wrist_frame_hand(recording.p_HK[recording.valid], "p_HK")
        recording = examine(recording)
        if training and (faults := training_faults(recording)):
            raise RecordingError("; ".join(faults))
    return recording


def _read_foreign(
    path: Path, file: File, side: str, format: str, unit: str | None, rate_hz: float | None
) -> Recording:
    """Returns a recording in another format than the package's own, unchecked.

    It is of the side that the file states, if it states one.
    """
    suffix = path.suffix.lower()
    format = _format_of(suffix, file) if format == AUTO else format
    if suffix not in FORMATS[format].suffixes:
        raise RecordingError(f"'{format}' is read from {', '.join(FORMATS[format].suffixes)}, not '{suffix}'")
    track = FORMATS[format].read(file, side)
    unit = unit or track.unit
    rows, t, about_times = _timed_frames(file, track, rate_hz)
    warnings = [*track.remarks, *about_times]
    p_WK = UNITS_M[unit] * track.p_WK[rows]
    lost = ~np.isfinite(p_WK).all(axis=(1, 2)) | (np.ptp(p_WK, axis=1).max(axis=1) < 1e-6)
    if lost.any():
        first = int(np.argmax(lost))
        warnings.append(
            f"{lost.sum()} of {len(lost)} frames show no hand or cannot be read, the first is {first}"
        )
        if lost.sum() > MAX_LOST * len(lost):
            raise RecordingError(f"{warnings[-1]}; at most one in ten may be lost")
    recording = Recording.from_keypoints(p_WK, t, track.side or side, track.in_world)
    metadata = {"source": path.name, "format": format, "unit": unit, **recording.metadata}
    metadata |= {"rate_known": track.t is not None or rate_hz is not None, "warnings": warnings}
    if len(t) and t[0] > _MIN_UNIX_TIME_S:
        metadata["start_time_unix_s"] = float(t[0])
    return dataclasses.replace(recording, metadata=metadata)


def _format_of(suffix: str, file: File) -> str:
    """Returns the name of the first format that a file fits."""
    candidates = {name: each for name, each in FORMATS.items() if suffix in each.suffixes}
    for name, each in candidates.items():
        if each.recognizes(file):
            return name
    fields = [f"{name}{getattr(value, 'shape', '')}" for name, value in file.fields.items()]
    contents = ", ".join(fields[:8]) + (", ..." if len(fields) > 8 else "")
    choices = "; ".join(f"{name} ({each.title})" for name, each in candidates.items())
    raise RecordingError(
        f"contains {contents or f'{len(file.frames)} frames'}, which matches no known format; choose one for "
        f"'{suffix}' files: {choices}; or make a recording of its keypoints with Recording.from_keypoints"
    )


def _timed_frames(
    file: File, track: Track, rate_hz: float | None
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Returns the numbers of the frames with usable times, these times, s, and sentences about the others.

    Raises:
        RecordingError: more than one in ten have no usable time, or the file says when its frames were taken,
            but in a way that is not read.
    """
    count = len(track.p_WK)
    if track.t is not None and np.isfinite(track.t).any():
        repeated = _repeats(track.t, track.p_WK)
        rows = _increasing(track.t, np.flatnonzero(np.isfinite(track.t) & ~repeated))
        repeats, untimed = int(repeated.sum()), count - len(rows) - int(repeated.sum())
        sentences = {
            f"{repeats} of {count} frames are stored twice with the same time": repeats,
            f"{untimed} of {count} frames have no time, or one that does not increase": untimed,
        }
        if untimed > MAX_LOST * count:
            raise RecordingError(next(reversed(sentences)))
        return rows, track.t[rows], [f"{text}: left out" for text, frames in sentences.items() if frames]
    rows, warnings = np.arange(count), []
    if rate_hz is None:
        remedy = "give the frames per second as --rate"
        if track.t is not None:
            raise RecordingError(f"the file has a time for each frame, but none is a finite number; {remedy}")
        if (name := unread_clock(file, count)) is not None:
            raise RecordingError(
                f"the field '{name}' is not read; {remedy}, or call a time for each frame one of: "
                f"{', '.join(TIME_FIELDS)}"
            )
        warnings = [f"no timestamps: {ASSUMED_RATE_HZ:g} Hz assumed; if you know better, convert with --rate"]
    return rows, rows / (rate_hz or ASSUMED_RATE_HZ), warnings


def _increasing(t: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Returns as many of the candidate rows of t (T,) as possible, in order, whose times increase."""
    ends: list[float] = []  # the smallest last time of the subsequences of each length
    last: list[int] = []
    previous = [-1] * len(t)
    for i in candidates.tolist():
        length = bisect.bisect_left(ends, t[i])
        previous[i] = last[length - 1] if length else -1
        ends[length : length + 1], last[length : length + 1] = [t[i]], [i]
    chain, i = [], last[-1] if last else -1
    while i >= 0:
        chain.append(i)
        i = previous[i]
    return np.array(chain[::-1], dtype=int)


def _repeats(t: np.ndarray, p_WK: np.ndarray) -> np.ndarray:
    """Returns which frames (T,) have the same time and points as the one before."""
    same = np.diff(t, prepend=np.nan) == 0
    same[1:] &= ((p_WK[1:] == p_WK[:-1]) | np.isnan(p_WK[1:])).all(axis=(1, 2))
    return same
