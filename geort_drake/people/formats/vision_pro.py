"""Apple Vision Pro: 4 x 4 transforms of joints in the wrist's frame, and of the wrist in the world.

`avp_stream` gives `right_fingers` (T, 25 or 27, 4, 4) or `right_arm` (T, 27, 4, 4), m: wrist 0, thumb 1-4,
then five each of index, middle, ring and little finger, from the metacarpal to the tip. Two of 27 joints
belong to the forearm: the last two, or in other releases the first two. The wrist's own transform is the
identity. `right_wrist` (T, 1, 4, 4) or (T, 4, 4) is the wrist in the world, z up. Left hands use `left_`.
Files are .npz, or .pkl with one dict per frame.

The app's own `tracking.jsonl` has a line per frame with `timestamp`, s, and `rightHand` and `leftHand`:
joints by name, 16 numbers each, column-major; `wrist` in the world, y up, the others in the wrist's frame.
A hand that is not seen has identity matrices everywhere; such frames are lost.

Source: https://github.com/Improbable-AI/VisionProTeleop, README and avp_stream/utils/grpc_utils.py; for
tracking.jsonl, Tracking Streamer/RecordingManager.swift
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from geort_drake.people.formats.contents import any_frame, empty_frames, frames_of, joints_of
from geort_drake.people.formats.source import KEYPOINTS_OF_25, NO_HAND, Format, Source, Tracks
from geort_drake.people.recording import SIDES

_FIELDS = ("fingers", "arm")
_APP_HANDS = [f"{side}Hand" for side in SIDES]
# Names of the 21 keypoints in tracking.jsonl.
_APP_JOINTS = ("wrist",) + tuple(
    f"{finger}{joint}"
    for finger in ("thumb", "index", "middle", "ring", "little")
    for joint in ("Knuckle", "IntermediateBase", "IntermediateTip", "Tip")
)


def _is_app(contents: Any) -> bool:
    """Whether these are the frames of a tracking.jsonl; some of them may show no hand."""
    return any_frame(contents, lambda frame: any(hand in frame for hand in _APP_HANDS))


def _is_vision_pro(contents: Any) -> bool:
    fields = {f"{side}_{field}" for side in SIDES for field in _FIELDS}
    header = isinstance(contents, Mapping) and bool(fields & contents.keys())
    return header or _is_app(contents) or any_frame(contents, lambda frame: bool(fields & frame.keys()))


def _read_vision_pro(file: Source, side: str) -> Tracks:
    if _is_app(file.contents):
        return _read_app(file, side)
    field = next((name for end in _FIELDS if file.has(name := f"{side}_{end}")), f"{side}_fingers")
    X_JK = file.transforms(field, file.array(field, (25, 4, 4), (27, 4, 4)))
    X_JK = X_JK[:, _wrist_index(file, field, X_JK) :][:, KEYPOINTS_OF_25]
    p_JK, t, wrist = X_JK[..., :3, 3], file.times(len(X_JK)), f"{side}_wrist"
    if not file.has(wrist):
        return Tracks(p_JK, t, side=side)
    X_WJ = file.array(wrist, (1, 4, 4), (4, 4), count=len(X_JK)).reshape(-1, 1, 4, 4)
    X_WJ = file.transforms(wrist, X_WJ)[:, 0]
    return Tracks(_in_world(file, wrist, X_WJ, p_JK), t, world=True, side=side)


def _read_app(file: Source, side: str) -> Tracks:
    hand, frames = f"{side}Hand", frames_of(file.contents)
    rows = file.each(frames, lambda frame: joints_of(frame, hand, _APP_JOINTS), (len(_APP_JOINTS), 16), hand)
    if not np.isfinite(rows).any():
        raise file.error(f"no frame has a {hand}; the file contains only the other hand")
    X = file.transforms(hand, rows.reshape(len(rows), -1, 4, 4), column_major=True)
    p_JK = np.concatenate([np.zeros_like(X[:, :1, :3, 3]), X[:, 1:, :3, 3]], axis=1)
    p_WK = _in_world(file, f"{hand}.wrist", X[:, 0], p_JK)
    return Tracks(p_WK, file.times(len(rows)), world=True, side=side)


def _wrist_index(file: Source, field: str, X_JK: np.ndarray) -> int:
    """Returns the index of the wrist, whose own transform stays the identity."""
    known = np.isfinite(X_JK).all(axis=(1, 2, 3)) & ~empty_frames(X_JK)
    candidates = (0,) if X_JK.shape[1] == 25 else (0, 2)
    moved = np.abs(X_JK[:, candidates] - np.eye(4)).max(axis=(2, 3), initial=0.0) > 1e-3
    row = int(np.argmin(moved[known].sum(axis=0)))
    what = f"{field} must be joints in the wrist's frame, where the wrist's own transform is the identity"
    file.mark_unreadable(moved[:, row] & known, known, what)
    return candidates[row]


def _in_world(file: Source, field: str, X_WJ: np.ndarray, p_JK: np.ndarray) -> np.ndarray:
    """Returns p_WK (T, K, 3) of joints p_JK (T, K, 3) in the wrist's frame J, with poses X_WJ (T, 4, 4)."""
    R = X_WJ[:, :3, :3]
    known = np.isfinite(R).all(axis=(1, 2)) & ~empty_frames(R)
    finite = np.where(known[:, None, None], R, np.eye(3))
    skews = np.abs(finite @ np.swapaxes(finite, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0) > 1e-2
    what = f"{field} must be rotations, which neither mirror nor scale"
    file.mark_unreadable(skews | (np.linalg.det(finite) < 0), known, what)
    file.faults.add(NO_HAND, np.flatnonzero(empty_frames(R)))
    with np.errstate(invalid="ignore", over="ignore"):
        return p_JK @ np.swapaxes(R, 1, 2) + X_WJ[:, None, :3, 3]


_SUFFIXES = (".npz", ".pkl", ".pickle", ".jsonl")
VISION_PRO = Format("Apple Vision Pro, 25 or 27 transforms", _SUFFIXES, _is_vision_pro, _read_vision_pro)
