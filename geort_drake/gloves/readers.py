"""Readers of recordings: our own .npz, GeoRT's .npy and raw MANUS .npz.

`docs/data_formats.md` describes the three formats.
"""

import os
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from geort_drake.errors import RecordingError, UnknownNameError
from geort_drake.gloves.keypoints import KEYPOINT_COUNT, mirrored, to_wrist_frame, wrist_pose
from geort_drake.gloves.recording import SIDES, Recording, check_recording, load_arrays

# GeoRT's .npy holds no timestamps. Free hand motion at 30 Hz gives this file fingertip speeds
# (99th percentile 1 m/s) that agree with gloves whose rate is known.
ASSUMED_RATE_HZ = 30.0

# MANUS nodes: wrist, then four of the thumb, then five per finger whose first, the metacarpal base,
# has no counterpart among the 21 keypoints.
_MANUS_NODES = 25
_METACARPAL_BASES = (5, 10, 15, 20)


def read_recording(path: str | os.PathLike, side: str = "right", training: bool = False) -> Recording:
    """Reads and checks a recording in any of the formats known, told apart by their contents.

    Args:
        path: .npy (T, 21, 3) in metres, raw MANUS .npz (T, 25, 7) or our own .npz.
        side: "right" or "left"; a left hand is mirrored (see `keypoints`). Files that say their
            side must agree.
        training: also ask for what training needs (see `check_recording`).

    Raises:
        RecordingError: the file is missing, malformed or holds no plausible hand of that side.
    """
    path = Path(path)
    if side not in SIDES:
        raise UnknownNameError("side", side, SIDES)
    if path.is_file() and path.suffix not in (".npy", ".npz"):
        raise RecordingError(f"{path}: recordings are read from .npy and .npz files, not '{path.suffix}'")
    arrays = load_arrays(path)
    if "p_HK" in arrays:
        recording = Recording.load(path)
        _agree_on_side(path, recording.side, side)
    elif "data" in arrays and "timestamps" in arrays:
        recording = _read_manus(path, arrays, side)
    elif path.suffix == ".npy":
        recording = _read_geort(path, arrays["data"], side)
    else:
        raise RecordingError(
            f"{path}: holds {', '.join(arrays) or 'nothing'}; a recording holds t, p_HK, valid, metadata "
            "and a raw MANUS file holds data, timestamps"
        )
    return check_recording(recording, str(path), training)


def _read_geort(path: Path, data: np.ndarray, side: str) -> Recording:
    p_WK = _numbers(path, "array", data, (KEYPOINT_COUNT, 3))
    p_HK = _canonical(p_WK, side)
    warnings = []
    moved = np.nanmax(np.abs(p_HK - p_WK), initial=0.0)
    if side == "right" and moved > 1e-3:
        warnings.append(f"not given in the wrist frame: moved by up to {1e3 * moved:.0f} mm to get there")
    t = np.arange(len(p_HK)) / ASSUMED_RATE_HZ
    warnings.append(f"no timestamps: {ASSUMED_RATE_HZ:g} Hz assumed")
    metadata = {
        "side": side,
        "source": path.name,
        "format": "GeoRT npy",
        "rate_known": False,
        "warnings": warnings,
    }
    return Recording(t, p_HK, np.ones(len(t), bool), None, metadata)


def _read_manus(path: Path, arrays: dict[str, np.ndarray], side: str) -> Recording:
    data = _numbers(path, "data", arrays["data"], (_MANUS_NODES, 7))
    timestamps = _numbers(path, "timestamps", arrays["timestamps"], ())
    if len(timestamps) != len(data):
        raise RecordingError(f"{path}: {len(timestamps)} timestamps for {len(data)} frames of data")
    if "chirality" in arrays:
        _agree_on_side(path, str(arrays["chirality"]).strip().lower(), side)
    nodes = np.asarray(arrays.get("keypoint_ids", np.arange(_MANUS_NODES)))
    if sorted(nodes.tolist()) != list(range(_MANUS_NODES)):
        raise RecordingError(f"{path}: keypoint_ids must be the numbers 0 to 24 in some order")
    kept = [i for i in range(_MANUS_NODES) if i not in _METACARPAL_BASES]
    p_WK = data[:, np.argsort(nodes), :3][:, kept]
    p_HK = _canonical(p_WK, side)
    valid = np.isfinite(p_HK).all(axis=(1, 2))
    # The wrist node's own quaternion turns with frame H up to a constant and the arching of the palm
    # (6° at most); the keypoints give frame H itself.
    R_WH, p_WH = wrist_pose(mirrored(p_WK) if side == "left" else p_WK)
    R_WH = np.where(valid[:, None, None], R_WH, np.eye(3))
    X_WH = np.concatenate([_continuous(Rotation.from_matrix(R_WH).as_quat(scalar_first=True)), p_WH], axis=1)
    travel = np.abs(p_WH[valid] - p_WH[valid][:1]).max(initial=0.0)
    metadata = {
        "side": side,
        "source": path.name,
        "format": "MANUS npz",
        "rate_known": True,
        "start_time_unix_s": float(timestamps[0]) if len(timestamps) else None,
        # A glove alone knows how the wrist is turned, not where it is.
        "wrist_position_tracked": bool(travel > 1e-3),
    }
    return Recording(timestamps - timestamps[:1], p_HK, np.ones(len(p_HK), bool), X_WH, metadata)


def _canonical(p_WK: np.ndarray, side: str) -> np.ndarray:
    return to_wrist_frame(mirrored(p_WK) if side == "left" else p_WK)


def _continuous(quaternions: np.ndarray) -> np.ndarray:
    """The same rotations with signs chosen so that neighbours are close and can be interpolated."""
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
    return quaternions * np.where(np.concatenate([[0], np.cumsum(flips)]) % 2, -1.0, 1.0)[:, None]


def _agree_on_side(path: Path, given: str, wanted: str) -> None:
    if given not in SIDES:
        raise RecordingError(f"{path}: side '{given}' is none of: {', '.join(SIDES)}")
    if given != wanted:
        raise RecordingError(f"{path}: the file holds a {given} hand, a {wanted} one was asked for")


def _numbers(path: Path, field: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    if value.shape[1:] != shape or value.ndim == 0 or value.dtype.kind not in "fiu":
        wanted = ", ".join(["T", *map(str, shape)])
        raise RecordingError(
            f"{path}: {field} must hold numbers of shape ({wanted}), not {value.dtype} {value.shape}"
        )
    return value.astype(float)
