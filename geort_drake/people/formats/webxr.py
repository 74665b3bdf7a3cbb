"""WebXR's 25 hand joints: OpenXR's without the palm, in .npz or JSON.

Order: wrist 0, thumb 1–4 (metacarpal, proximal, distal, tip), then five each of index 5–9, middle 10–14,
ring 15–19 and pinky 20–24: metacarpal, proximal, intermediate, distal, tip. Metres in the reference space,
right-handed, y up, −z forward.

.npz: `joints` (T, 25, 3), (T, 25, 7) with `px py pz qx qy qz qw`, or (T, 25, 16) and (T, 400) as
`XRFrame.fillPoses` fills them, column by column; optionally `t`, s, and `handedness`. JSON:
`{"handedness": "right", "frames": [{"time": ms, "joints": {"wrist": {...}, ...}}]}`, time a
DOMHighResTimeStamp and joints by the names of XRHandJoint, each with `position` {x, y, z} or null; or
`poses`, 400 numbers.

Source: https://www.w3.org/TR/webxr-hand-input-1/ and
https://developer.mozilla.org/en-US/docs/Web/API/XRFrame/fillPoses
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
    point,
    side_of,
    times,
)

SUFFIXES = (".json", ".jsonl", ".npz")

_PHALANGES = ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
JOINT_NAMES = (
    "wrist",
    *(f"thumb-{bone}" for bone in _PHALANGES if bone != "phalanx-intermediate"),
    *(f"{finger}-finger-{bone}" for finger in ("index", "middle", "ring", "pinky") for bone in _PHALANGES),
)


def recognizes(contents: Any) -> bool:
    if isinstance(contents, dict) and "joints" in contents:
        shape = contents["joints"].shape if isinstance(contents["joints"], np.ndarray) else ()
        return shape[1:2] in ((25,), (400,))
    frames = contents.get("frames") if isinstance(contents, dict) else contents
    return (
        isinstance(frames, list)
        and bool(frames)
        and isinstance(frames[0], dict)
        and (isinstance(frames[0].get("joints"), dict) or "poses" in frames[0])
    )


def read(name: str, contents: Any, side: str) -> Tracks:
    if isinstance(contents, dict) and "frames" not in contents:
        if "joints" not in contents:
            raise RecordingError(f"{name}: WebXR joints must be called joints, not {', '.join(contents)}")
        field, value = "joints", contents["joints"]
        clock = times(name, contents, len(value))
        stated = side_of(name, contents)
    else:
        frames = frames_of(name, contents)
        packed = any("poses" in frame for frame in frames)
        field = "poses" if packed else "joints"
        value = [frame.get("poses") if packed else _points(name, i, frame) for i, frame in enumerate(frames)]
        clock = json_times(name, frames, "time", "ms")
        stated = side_of(name, contents) if isinstance(contents, dict) else None
    p, findings = joint_positions(name, field, value, 25, column_major=True)
    return Tracks(p[:, KEYPOINTS_OF_25], clock, world=True, side=stated, findings=findings)


def _points(name: str, i: int, frame: dict) -> list[list[float]]:
    joints = frame.get("joints")
    if not isinstance(joints, dict):
        raise RecordingError(f"{name}: frame {i}: joints must be an object with the names of XRHandJoint")
    missing = [joint for joint in JOINT_NAMES if joint not in joints]
    if missing:
        raise RecordingError(f"{name}: frame {i} lacks {len(missing)} of 25 joints, such as {missing[0]}")
    return [_point(name, f"frame {i}, {joint}", joints[joint]) for joint in JOINT_NAMES]


def _point(name: str, where: str, joint: Any) -> list[float]:
    return point(name, where, joint["position"] if isinstance(joint, dict) and "position" in joint else joint)
