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
from geort_drake.people.checks import UNITS_M, examine, require_side, require_wrist_frame_hand
from geort_drake.people.coverage import training_faults
from geort_drake.people.formats import FORMATS, TIME_FIELDS, Track, load, unread_clock
from geort_drake.people.recording import SIDES, Recording

# For files without timestamps. At 30 Hz, GeoRT's recording has fingertip speeds (99th percentile 1 m/s) that
# agree with gloves whose rate is known.
ASSUMED_RATE_HZ = 30.0
AUTO, OWN = "auto", "geort_drake"

_MIN_UNIX_TIME_S = 1e8  # in 1973; later times are Unix times, smaller ones count from the device's start
_MAX_UNTIMED = 0.1  # largest fraction of frames without a usable time


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
    contents = load(path)
    with naming(path, RecordingError):
        is_own = format == OWN or (format == AUTO and isinstance(contents, dict) and "p_HK" in contents)
        if is_own:
            recording = _read_own(contents, unit)
        else:
            recording = _read_foreign(path, contents, side, format, unit, rate_hz)
        require_side(recording.side, side)
        if is_own and recording.valid.any():  # of other files, the wrist frame is computed here
            require_wrist_frame_hand(recording.p_HK[recording.valid], "p_HK")
        recording = examine(recording)
        if training and (faults := training_faults(recording)):
            raise RecordingError("; ".join(faults))
    return recording


def _read_own(contents: dict, unit: str | None) -> Recording:
    if unit not in (None, "m"):
        raise RecordingError(f"geort-drake's own files are in metres, not in {unit}")
    return Recording.from_arrays(contents)


def _read_foreign(
    path: Path, contents: object, side: str, format: str, unit: str | None, rate_hz: float | None
) -> Recording:
    """Returns a recording in another format than the package's own, unchecked.

    It is of the side that the file states, if it states one.
    """
    suffix = path.suffix.lower()
    if format == AUTO:
        fitting = [
            name for name, each in FORMATS.items() if suffix in each.suffixes and each.recognizes(contents)
        ]
        if not fitting:
            choices = "; ".join(
                f"{name} ({each.title})" for name, each in FORMATS.items() if suffix in each.suffixes
            )
            raise RecordingError(
                f"contains {_summary(contents)}, which matches no known format; choose one for '{suffix}' "
                f"files: {choices}; or make a recording of its keypoints with Recording.from_keypoints"
            )
        format = fitting[0]
    if suffix not in FORMATS[format].suffixes:
        raise RecordingError(f"'{format}' is read from {', '.join(FORMATS[format].suffixes)}, not '{suffix}'")
    track = FORMATS[format].read(contents, side)
    unit = unit or track.unit
    warnings = list(track.remarks)
    metadata: dict = {"source": path.name, "format": format, "unit": unit}
    t, p_WK, timed = track.t, UNITS_M[unit] * track.p_WK, True
    if t is not None and np.isfinite(t).any():
        order = _usable_times(t, p_WK)
        if len(order) < len(t):
            repeats = int(_repeats(t, p_WK).sum())
            if (untimed := len(t) - len(order) - repeats) > _MAX_UNTIMED * len(t):
                raise RecordingError(
                    f"{untimed} of {len(t)} frames have no time, or one that does not increase"
                )
            warnings += [
                f"{repeats} of {len(t)} frames are stored twice with the same time: left out"
            ] * bool(repeats)
            warnings += [
                f"{untimed} of {len(t)} frames have no time, or one that does not increase: left out"
            ] * bool(untimed)
        t, p_WK = t[order], p_WK[order]
        if t[0] > _MIN_UNIX_TIME_S:
            metadata["start_time_unix_s"] = float(t[0])
    else:
        if rate_hz is None:
            _require_no_clock(contents, track)
        t = np.arange(len(p_WK)) / (rate_hz or ASSUMED_RATE_HZ)
        timed = rate_hz is not None
        if not timed:
            warnings.append(
                f"no timestamps: {ASSUMED_RATE_HZ:g} Hz assumed; if you know better, convert with --rate"
            )
    lost = ~np.isfinite(p_WK).all(axis=(1, 2)) | (np.ptp(p_WK, axis=1).max(axis=1) < 1e-6)
    if lost.any():
        first = int(np.argmax(lost))
        warnings.append(
            f"{lost.sum()} of {len(lost)} frames show no hand or cannot be read, the first is {first}"
        )
        if lost.sum() > _MAX_UNTIMED * len(lost):
            raise RecordingError(f"{warnings[-1]}; at most one in ten may be lost")
    recording = Recording.from_keypoints(p_WK, t, track.side or side, track.in_world)
    metadata |= {**recording.metadata, "rate_known": timed, "warnings": warnings}
    return dataclasses.replace(recording, metadata=metadata)


def _require_no_clock(contents: object, track: Track) -> None:
    """Raises RecordingError if the file says when its frames were taken, but in a way that is not read."""
    remedy = "give the frames per second as --rate"
    if track.t is not None:
        raise RecordingError(f"the file has a time for each frame, but none is a finite number; {remedy}")
    if (name := unread_clock(contents, len(track.p_WK))) is not None:
        raise RecordingError(
            f"the field '{name}' is not read; {remedy}, or call a time for each frame one of: "
            f"{', '.join(TIME_FIELDS)}"
        )


def _usable_times(t: np.ndarray, p_WK: np.ndarray) -> np.ndarray:
    """Returns the indices of the frames whose times increase: as many as possible, without repeats."""
    candidates = np.flatnonzero(np.isfinite(t) & ~_repeats(t, p_WK))
    ends: list[float] = []  # the smallest last time of the subsequences of each length
    last: list[int] = []
    before = [-1] * len(t)
    for i in candidates.tolist():
        length = bisect.bisect_left(ends, t[i])
        before[i] = last[length - 1] if length else -1
        ends[length : length + 1], last[length : length + 1] = [t[i]], [i]
    chain, i = [], last[-1] if last else -1
    while i >= 0:
        chain.append(i)
        i = before[i]
    return np.array(chain[::-1], dtype=int)


def _repeats(t: np.ndarray, p_WK: np.ndarray) -> np.ndarray:
    same = np.diff(t, prepend=np.nan) == 0
    same[1:] &= ((p_WK[1:] == p_WK[:-1]) | np.isnan(p_WK[1:])).all(axis=(1, 2))
    return same


def _summary(contents: object) -> str:
    if isinstance(contents, dict):
        names = [f"{name}{getattr(value, 'shape', '')}" for name, value in contents.items()]
        return ", ".join(names[:8]) + (", ..." if len(names) > 8 else "") or "nothing"
    return (
        f"{type(contents).__name__} of {len(contents)}" if isinstance(contents, list | tuple) else "no frames"
    )
