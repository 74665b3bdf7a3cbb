"""OpenXR's 26 hand joints (XR_EXT_hand_tracking), in .npz or JSON.

Order: palm 0, wrist 1, thumb 2–5 (metacarpal, proximal, distal, tip), then five each of index 6–10,
middle 11–15, ring 16–20 and little finger 21–25: metacarpal, proximal, intermediate, distal, tip, each the
base of the bone of that name. Metres in the base space of the locate call, right-handed, y up.

.npz: `joints` (T, 26, 3), (T, 26, 7) with `px py pz qx qy qz qw`, or (T, 26, 4, 4); optionally `t`, s,
`valid` (T, 26) and `hand`. JSON: `{"hand": "right", "frames": [{"time": ns, "joints": [...]}]}`, where time
is an XrTime and each of the 26 joints an XrHandJointLocationEXT: `pose` (or just its `position`) and
`locationFlags`, whose bit 2 says that the position is valid. A frame may also say `isActive`, as
XrHandJointLocationsEXT does; where that is false, or joints are none, the hand is lost.

Source: https://registry.khronos.org/OpenXR/specs/1.1/man/html/XrHandJointEXT.html and
https://registry.khronos.org/OpenXR/specs/1.1/man/html/XrHandJointLocationEXT.html
"""

from typing import Any

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.people.formats.tracks import (
    KEYPOINTS_OF_25,
    Tracks,
    frames_of,
    joint_positions,
    json_times,
    numbers,
    point,
    side_of,
    times,
)

SUFFIXES = (".json", ".jsonl", ".npz")

_JOINTS = 26
_PALM, _WRIST, _MIDDLE_PROXIMAL = 0, 1, 12
_POSITION_VALID = 2  # XR_SPACE_LOCATION_POSITION_VALID_BIT


def recognizes(contents: Any) -> bool:
    if isinstance(contents, dict) and "joints" in contents:
        shape = contents["joints"].shape if isinstance(contents["joints"], np.ndarray) else ()
        return shape[1:2] in ((_JOINTS,), (_JOINTS * 16,))
    frames = contents.get("frames") if isinstance(contents, dict) else contents
    return isinstance(frames, list) and any(
        isinstance(frame, dict) and isinstance(frame.get("joints"), list) for frame in frames
    )


def read(name: str, contents: Any, side: str) -> Tracks:
    if isinstance(contents, dict) and "frames" not in contents:
        if "joints" not in contents:
            raise RecordingError(f"{name}: OpenXR joints must be called joints, not {', '.join(contents)}")
        p, findings = joint_positions(name, "joints", contents["joints"], _JOINTS)
        clock = times(name, contents, len(p))
        if "valid" in contents:
            valid = np.asarray(contents["valid"])
            if valid.shape != p.shape[:2] or valid.dtype != bool:
                raise RecordingError(
                    f"{name}: valid must be boolean of shape {p.shape[:2]}, not {valid.dtype} {valid.shape}"
                )
            p = np.where(valid[..., None], p, np.nan)
        stated = side_of(name, contents)
    else:
        frames = frames_of(name, contents)
        p, findings = (
            numbers(name, "joints", [_points(name, i, f) for i, f in enumerate(frames)], (26, 3)),
            [],
        )
        clock = json_times(name, frames, "time", "ns")
        stated = side_of(name, contents) if isinstance(contents, dict) else None
    _check_palm(name, p)
    return Tracks(p[:, 1:][:, KEYPOINTS_OF_25], clock, world=True, side=stated, findings=findings)


def _points(name: str, i: int, frame: dict) -> list[list[float]]:
    joints = frame.get("joints")
    if frame.get("isActive") is False or joints in (None, []):
        return [[np.nan] * 3] * _JOINTS
    if not isinstance(joints, list) or len(joints) != _JOINTS:
        given = len(joints) if isinstance(joints, list) else type(joints).__name__
        raise RecordingError(f"{name}: frame {i}: {_JOINTS} joints are wanted, {given} given")
    return [_point(name, f"frame {i}, joint {j}", joint) for j, joint in enumerate(joints)]


def _point(name: str, where: str, joint: Any) -> list[float]:
    if not isinstance(joint, dict):
        return point(name, where, joint)
    flags = joint.get("locationFlags", _POSITION_VALID)
    if not isinstance(flags, int):
        raise RecordingError(f"{name}: {where}: locationFlags must be a whole number, not {flags!r:.40}")
    if not flags & _POSITION_VALID:
        return [np.nan] * 3
    pose = joint.get("pose", joint)
    return point(name, where, pose["position"] if isinstance(pose, dict) and "position" in pose else pose)


def _check_palm(name: str, p: np.ndarray) -> None:
    """The palm, which lies between the wrist and the knuckles, comes first."""
    reach = np.linalg.norm(p[:, [_PALM, _WRIST]] - p[:, [_MIDDLE_PROXIMAL]], axis=-1)
    reach = reach[np.isfinite(reach).all(axis=1)]
    if len(reach) and np.median(reach[:, 0] - reach[:, 1]) > 0:
        raise RecordingError(
            f"{name}: wrong joint order: joint 0 must be the palm and joint 1 the wrist, but joint 0 is "
            "farther from the middle knuckle (joint 12); swap them"
        )
