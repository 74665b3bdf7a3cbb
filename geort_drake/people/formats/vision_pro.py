"""Apple Vision Pro as `avp_stream` gives it: 4 × 4 transforms of joints in the wrist, and of the wrist.

`right_fingers` (T, 25, 4, 4) or (T, 27, 4, 4), or `right_arm` (T, 27, 4, 4), hold the joints in the wrist's
frame, m: wrist 0, thumb 1–4 (knuckle, intermediate base, intermediate tip, tip), then five each of index,
middle, ring and little finger (metacarpal, knuckle, intermediate base, intermediate tip, tip); of 27 the last
two are of the forearm, or in other releases the first two: the wrist's transform, the identity, tells.
`right_wrist` (T, 1, 4, 4) or (T, 4, 4) is the wrist in the world, m, z up. The same with `left_`.

.npz with these arrays and optionally `timestamps`, s; or a .pkl with a list of dicts, one per frame, as
`VisionProStreamer(record=True)` collects them, optionally each with a `timestamp`, s.

`tracking.jsonl`, which the app itself records, has a line per frame: `timestamp`, s, and `rightHand` and
`leftHand` where there are any, with the joints by name (`wrist`, `thumbKnuckle` ... `littleTip`), 16 numbers
each, column by column; `wrist` in the world, m, y up, the others from the wrist.

A hand that is not seen has identity matrices everywhere; such frames are lost.

Source: https://github.com/Improbable-AI/VisionProTeleop, README and avp_stream/utils/grpc_utils.py, and of
tracking.jsonl Tracking Streamer/RecordingManager.swift
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.people.formats.tracks import (
    KEYPOINTS_OF_25,
    Tracks,
    empty_frames,
    frames_of,
    is_number,
    json_times,
    numbers,
    shape_of,
    times,
    transforms,
)
from geort_drake.people.recording import SIDES

SUFFIXES = (".npz", ".pkl", ".pickle", ".jsonl")

_JOINTS = ("fingers", "arm")
_APP_HANDS = {side: f"{side}Hand" for side in SIDES}
# The 21 keypoints by the names of tracking.jsonl.
_APP_JOINTS = ("wrist",) + tuple(
    f"{finger}{joint}"
    for finger in ("thumb", "index", "middle", "ring", "little")
    for joint in ("Knuckle", "IntermediateBase", "IntermediateTip", "Tip")
)


def recognizes(contents: Any) -> bool:
    if _is_from_app(contents):
        return True
    first = contents[0] if isinstance(contents, list) and contents else contents
    return isinstance(first, Mapping) and any(
        f"{side}_{field}" in first for side in SIDES for field in _JOINTS
    )


def read(name: str, contents: Any, side: str) -> Tracks:
    if _is_from_app(contents):
        return _read_app(name, frames_of(name, contents), side)
    arrays = _stacked(name, contents) if isinstance(contents, list) else contents
    field = next((f"{side}_{field}" for field in _JOINTS if f"{side}_{field}" in arrays), None)
    if field is None:
        raise RecordingError(
            f"{name}: a {side} hand must be called {side}_fingers; given: {', '.join(arrays)}"
        )
    X_JK, findings = transforms(name, field, numbers(name, field, arrays[field], (25, 4, 4), (27, 4, 4)))
    X_JK = X_JK[:, _wrist_place(name, field, X_JK) :][:, KEYPOINTS_OF_25]
    clock = times(name, arrays, len(X_JK))
    p_JK = X_JK[..., :3, 3]
    if f"{side}_wrist" not in arrays:
        return Tracks(p_JK, clock, side=side, findings=findings)
    field = f"{side}_wrist"
    X_WJ = numbers(name, field, arrays[field], (1, 4, 4), (4, 4)).reshape(-1, 4, 4)
    if len(X_WJ) != len(X_JK):
        raise RecordingError(f"{name}: {len(X_WJ)} {field} for {len(X_JK)} frames of joints")
    X_WJ, turned = transforms(name, field, X_WJ)
    p_WK = _in_world(name, field, X_WJ, p_JK)
    return Tracks(p_WK, clock, world=True, side=side, findings=[*findings, *turned])


def _is_from_app(contents: Any) -> bool:
    """Whether these are the lines of a tracking.jsonl, the first of which may show no hand."""
    return isinstance(contents, list) and any(
        isinstance(frame, Mapping) and any(hand in frame for hand in _APP_HANDS.values())
        for frame in contents
    )


def _read_app(name: str, frames: Sequence[dict], side: str) -> Tracks:
    field = _APP_HANDS[side]
    if not any(frame.get(field) for frame in frames):
        raise RecordingError(f"{name}: no frame has a {field}; the file holds the other hand alone")
    rows = [_app_joints(name, f"frame {i}, {field}", frame.get(field)) for i, frame in enumerate(frames)]
    X, findings = transforms(
        name, field, np.array(rows).reshape(-1, len(_APP_JOINTS), 4, 4), column_major=True
    )
    p_JK = np.concatenate([np.zeros_like(X[:, :1, :3, 3]), X[:, 1:, :3, 3]], axis=1)
    p_WK = _in_world(name, f"{field}.wrist", X[:, 0], p_JK)
    clock = json_times(name, frames, "timestamp", "s")
    return Tracks(p_WK, clock, world=True, side=side, findings=findings)


def _app_joints(name: str, where: str, hand: Any) -> list[list[float]]:
    """16 numbers of each of `_APP_JOINTS`; NaN where there is no hand."""
    if hand is None:
        return [[np.nan] * 16] * len(_APP_JOINTS)
    if not isinstance(hand, Mapping):
        raise RecordingError(f"{name}: {where} must be an object with joints by name, not {hand!r:.40}")
    for joint in _APP_JOINTS:
        given = hand.get(joint)
        if not isinstance(given, list) or len(given) != 16 or not all(map(is_number, given)):
            raise RecordingError(f"{name}: {where}.{joint} must be 16 numbers, not {given!r:.60}")
    return [hand[joint] for joint in _APP_JOINTS]


def _in_world(name: str, field: str, X_WJ: np.ndarray, p_JK: np.ndarray) -> np.ndarray:
    """p_WK (T, K, 3) of joints p_JK (T, K, 3) in the wrist's frame J, whose poses are X_WJ (T, 4, 4)."""
    _check_rotations(name, field, X_WJ[:, :3, :3])
    return p_JK @ np.swapaxes(X_WJ[:, :3, :3], 1, 2) + X_WJ[:, None, :3, 3]


def _stacked(name: str, frames: list) -> dict[str, Any]:
    """Arrays (T, ...) of the fields that all frames have."""
    if not all(isinstance(frame, Mapping) for frame in frames):
        raise RecordingError(f"{name}: a list of dicts is wanted, one per frame")
    wanted = {f"{side}_{field}" for side in SIDES for field in (*_JOINTS, "wrist")}
    fields = [field for field in frames[0] if field in wanted]
    for i, frame in enumerate(frames):
        missing = [field for field in fields if field not in frame]
        if missing:
            raise RecordingError(f"{name}: frame {i} lacks {missing[0]}, which frame 0 has")
        for field in fields:
            given = shape_of(frame[field])
            if given is None or given != shape_of(frames[0][field]):
                raise RecordingError(f"{name}: frame {i}: {field} has shape {given}, not frame 0's")
    arrays: dict[str, Any] = {field: np.array([frame[field] for frame in frames]) for field in fields}
    if "timestamp" in frames[0]:
        arrays["timestamps"] = [frame.get("timestamp", np.nan) for frame in frames]
    return arrays


def _wrist_place(name: str, field: str, X_JK: np.ndarray) -> int:
    """Which joint is the wrist, from which the others are measured: the one that never moves."""
    for place in (0,) if X_JK.shape[1] == 25 else (0, 2):
        off = np.abs(X_JK[:, place] - np.eye(4)).max(axis=(1, 2))
        off[empty_frames(X_JK)] = 0.0
        if np.nanmax(off, initial=0.0) < 1e-3:
            return place
    raise RecordingError(
        f"{name}: {field} must hold joints in the wrist's frame, where the wrist's own transform (joint 0) "
        "is the identity in every frame; these are in another frame, or in another order"
    )


def _check_rotations(name: str, field: str, R: np.ndarray) -> None:
    known = R[np.isfinite(R).all(axis=(1, 2)) & ~empty_frames(R)]
    determinant = np.linalg.det(known)
    skew = np.abs(known @ np.swapaxes(known, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    bad = np.flatnonzero((skew > 1e-2) | (determinant < 0))
    if len(bad):
        told = "mirrors" if determinant[bad[0]] < 0 else "scales or shears"
        raise RecordingError(f"{name}: {field} must hold rotations, but frame {bad[0]}'s {told}")
