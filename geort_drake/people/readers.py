"""Reading of recordings in any of the formats known (`formats`), into the wrist frame, and checked.

`docs/reference` describes the formats and the checks.
"""

import os
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from geort_drake.errors import RecordingError, UnknownNameError
from geort_drake.people.checks import check_recording, noted
from geort_drake.people.checks.anatomy import UNITS_M
from geort_drake.people.checks.findings import Finding, Severity
from geort_drake.people.formats import AUTO, FORMATS, choose, suffix_of
from geort_drake.people.formats.files import load
from geort_drake.people.formats.tracks import Tracks
from geort_drake.people.keypoints import mirrored, to_wrist_frame, wrist_pose
from geort_drake.people.recording import SIDES, Recording
from geort_drake.people.recording_parts import read_parts

# For files without timestamps. Free hand motion at 30 Hz gives GeoRT's recording fingertip speeds
# (99th percentile 1 m/s) that agree with gloves whose rate is known.
ASSUMED_RATE_HZ = 30.0

_ONE_PLACE_M = 1e-6  # keypoints that are nearer to each other are no hand, m
_UNIX_S = 1e8  # times beyond this, in 1973, count from 1970; others from wherever the device started


def read_recording(
    path: str | os.PathLike,
    side: str = "right",
    training: bool = False,
    format: str = AUTO,
    unit: str | None = None,
    rate_hz: float | None = None,
) -> Recording:
    """Reads and checks a recording in any of the formats known.

    Args:
        path: a file, or HO-3D's folder `meta`.
        side: "right" or "left"; a left hand is mirrored (see `keypoints`). Files that say their
            side must agree.
        training: also ask for what training needs (see `check_recording`).
        format: a name of `FORMATS`; "auto" tells them apart by their contents.
        unit: of lengths in the file, one of `UNITS_M`; by default the format's.
        rate_hz: frames per second of a file without timestamps; by default `ASSUMED_RATE_HZ`.

    Raises:
        RecordingError: the file is missing, malformed or holds no plausible hand of that side.
        UnknownNameError: there is no such side, format or unit.
    """
    recording, findings = open_recording(path, side, format, unit, rate_hz)
    return check_recording(noted(recording, findings), str(path), training)


def open_recording(
    path: str | os.PathLike,
    side: str = "right",
    format: str = AUTO,
    unit: str | None = None,
    rate_hz: float | None = None,
) -> tuple[Recording, list[Finding]]:
    """Reads a recording without judging its contents; arguments and errors are those of `read_recording`.

    Returns:
        The recording, with the format that was taken in `metadata["format"]`, and what the reader saw.
    """
    path = Path(path)
    for kind, given, choices in (("side", side, SIDES), ("unit", unit, UNITS_M)):
        if given is not None and given not in choices:
            raise UnknownNameError(kind, given, choices)
    if (unfinished := read_parts(path)) is not None:
        _agree_on_side(path, unfinished.side, side)
        return unfinished, []
    contents = load(path)
    chosen = choose(str(path), suffix_of(path), contents, format)
    read = FORMATS[chosen].read(str(path), contents, side)
    _agree_on_side(path, read.side, side)
    if isinstance(read, Recording):
        if unit not in (None, "m"):
            raise RecordingError(f"{path}: geort-drake's own files are in metres, not in {unit}")
        return read, []
    return _recording(path, chosen, read, side, unit or read.unit, rate_hz)


def _recording(
    path: Path, chosen: str, tracks: Tracks, side: str, unit: str, rate_hz: float | None
) -> tuple[Recording, list[Finding]]:
    findings = list(tracks.findings)
    p_WK, clock = UNITS_M[unit] * tracks.p_WK, tracks.clock
    metadata = {"side": side, "source": path.name, "format": chosen, "rate_known": True, **tracks.metadata}
    metadata["unit"] = unit
    if clock is not None:
        t, metadata["time_field"], metadata["time_unit"] = clock.t, clock.field, clock.unit
    else:
        t, metadata["rate_known"] = np.arange(len(p_WK)) / (rate_hz or ASSUMED_RATE_HZ), rate_hz is not None
        if rate_hz is None:
            findings.append(_no_times())
    p_WK = _without_empty(p_WK, findings)
    p_WK, t = _without_doubles(p_WK, t, findings)
    if len(t) and t[0] > _UNIX_S:
        metadata["start_time_unix_s"] = float(t[0])
    p_VK = mirrored(p_WK) if side == "left" else p_WK
    p_HK = to_wrist_frame(p_VK)
    _check_palm_plane(path, p_WK, p_HK)
    X_WH = None
    if tracks.world:
        valid = np.isfinite(p_HK).all(axis=(1, 2))
        X_WH = _wrist_poses(p_VK, valid)
        travel = np.abs(X_WH[valid, 4:] - X_WH[valid, 4:][:1]).max(initial=0.0)
        # A glove alone knows how the wrist is turned, not where it is.
        metadata["wrist_position_tracked"] = bool(travel > 1e-3)
    return Recording(t - t[:1], p_HK, np.ones(len(t), bool), X_WH, metadata), findings


def _wrist_poses(p_WK: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """X_WH (T, 7) as the keypoints give it; without rotation in frames that are not valid."""
    R_WH, p_WH = wrist_pose(p_WK)
    if not len(p_WH):
        return np.empty((0, 7))  # SciPy 1.15 makes no rotations of nothing
    # Of a hand that is larger than numbers can say, nothing is left.
    turned = valid & (np.linalg.det(np.nan_to_num(R_WH)) > 0.5)
    R_WH = np.where(turned[:, None, None], R_WH, np.eye(3))
    return np.concatenate([_continuous(Rotation.from_matrix(R_WH).as_quat(scalar_first=True)), p_WH], axis=1)


def _continuous(quaternions: np.ndarray) -> np.ndarray:
    """The same rotations with signs chosen so that neighbours are close and can be interpolated."""
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
    return quaternions * np.where(np.concatenate([[0], np.cumsum(flips)]) % 2, -1.0, 1.0)[:, None]


def _no_times() -> Finding:
    return Finding(
        "timestamps",
        Severity.WARNING,
        f"no timestamps: {ASSUMED_RATE_HZ:g} Hz assumed",
        advice="import the file with --rate if you know better",
    )


def _without_empty(p_WK: np.ndarray, findings: list[Finding]) -> np.ndarray:
    """NaN in frames without a hand, in which trackers store the origin for every joint, and says so."""
    with np.errstate(invalid="ignore"):
        empty = np.ptp(p_WK, axis=1).max(axis=1, initial=0.0) < _ONE_PLACE_M
    if not empty.any():
        return p_WK
    first = int(np.argmax(empty))
    findings.append(
        Finding(
            "lost frames",
            Severity.WARNING,
            f"{int(empty.sum())} of {len(p_WK)} frames hold no hand, as all keypoints are in one place; the "
            f"first is frame {first}",
            f"frame {first}",
            "taken for lost",
        )
    )
    return np.where(empty[:, None, None], np.nan, p_WK)


def _without_doubles(
    p_WK: np.ndarray, t: np.ndarray, findings: list[Finding]
) -> tuple[np.ndarray, np.ndarray]:
    """Leaves out frames that repeat the one before in time and keypoints, and says so."""
    same = np.diff(t) == 0
    same &= ((p_WK[1:] == p_WK[:-1]) | np.isnan(p_WK[1:])).all(axis=(1, 2))
    if not same.any():
        return p_WK, t
    first = int(np.argmax(same)) + 1
    findings.append(
        Finding(
            "duplicated frames",
            Severity.WARNING,
            f"{int(same.sum())} of {len(t)} frames are stored twice with the same time, the first is frame "
            f"{first}",
            f"t[{first}]",
            "left out",
        )
    )
    kept = np.concatenate([[True], ~same])
    return p_WK[kept], t[kept]


def _check_palm_plane(path: Path, p_WK: np.ndarray, p_HK: np.ndarray) -> None:
    """The wrist frame exists where there are keypoints."""
    lacking = np.isfinite(p_WK).all(axis=(1, 2)) & ~np.isfinite(p_HK).all(axis=(1, 2))
    if lacking.any():
        raise RecordingError(
            f"{path}: wrist, index, middle and ring knuckles (keypoints 0, 5, 9, 13) must span a plane, but "
            f"coincide or lie on a line in {lacking.sum()} of {len(p_WK)} frames, first in frame "
            f"{int(np.argmax(lacking))}"
        )


def _agree_on_side(path: Path, given: str | None, wanted: str) -> None:
    if given is not None and given != wanted:
        raise RecordingError(
            f"{path}: the file holds a {given} hand, a {wanted} one was asked for; import_recording.py makes "
            f"it a {wanted} one's with --side {given} --mirror"
        )
