"""Hand joints of OpenXR (26) and WebXR (25), in .npz or JSON.

OpenXR's order: palm, wrist, four of the thumb (metacarpal, proximal, distal, tip), then five each of index,
middle, ring and little finger (metacarpal, proximal, intermediate, distal, tip), each the base of the bone
of that name. WebXR's is the same without the palm. Metres, right-handed, y up, in the base or reference
space.

OpenXR .npz: `joints` (T, 26, 3), (T, 26, 7) with `px py pz qx qy qz qw`, or (T, 26, 4, 4); optionally `t`,
s, `valid` (T, 26) and `hand`. JSON: `{"hand": "right", "frames": [{"time": ns, "joints": [...]}]}`: time is
an XrTime, each joint an XrHandJointLocationEXT with `pose` (or its `position`) and `locationFlags`, whose
bit 2 says that the position is valid. Where `isActive` is false or joints are none, the hand is lost.
Source: https://registry.khronos.org/OpenXR/specs/1.1/man/html/XrHandJointEXT.html and
https://registry.khronos.org/OpenXR/specs/1.1/man/html/XrHandJointLocationEXT.html

WebXR .npz: `joints` (T, 25, 3), (T, 25, 7), or (T, 25, 16) and (T, 400) as `XRFrame.fillPoses` fills them,
column by column; optionally `t`, s, and `handedness`. JSON: `{"handedness": "right", "frames": [{"time":
ms, "joints": {"wrist": {...}, ...}}]}`: joints by the names of XRHandJoint, each with `position` or null;
or `poses`, 400 numbers.
Source: https://www.w3.org/TR/webxr-hand-input-1/ and
https://developer.mozilla.org/en-US/docs/Web/API/XRFrame/fillPoses
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from geort_drake.people.formats.source import (
    KEYPOINTS_OF_25,
    BadFrame,
    Format,
    Source,
    Tracks,
    frames_of,
    point,
    shape_in,
)

_SUFFIXES = (".json", ".jsonl", ".npz")
_OPENXR_KEYPOINTS = [k + 1 for k in KEYPOINTS_OF_25]
_PALM, _WRIST, _MIDDLE_PROXIMAL = 0, 1, 12
_POSITION_VALID = 2  # XR_SPACE_LOCATION_POSITION_VALID_BIT
_BONES = ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
_WEBXR_JOINTS = (
    "wrist",
    *(f"thumb-{bone}" for bone in _BONES if bone != "phalanx-intermediate"),
    *(f"{finger}-finger-{bone}" for finger in ("index", "middle", "ring", "pinky") for bone in _BONES),
)


def _is_openxr(contents: Any) -> bool:
    lists, objects = _kinds(contents)
    return shape_in(contents, "joints")[1:2] in ((26,), (416,)) or lists > objects


def _read_openxr(file: Source, side: str) -> Tracks:
    if frames_of(file.contents):
        p, findings = file.positions("joints", file.each(file.frames(), _openxr_points, (26, 3), "joints"))
        clock = file.times(len(p), "time", "ns")
    else:
        p, findings = file.positions("joints", file.array("joints", *_shapes(26)))
        clock = file.times(len(p))
    _check_palm(file, p)
    p = np.where(_valid(file, len(p))[..., None], p, np.nan)
    return Tracks(p[:, _OPENXR_KEYPOINTS], clock, world=True, side=file.side(), findings=findings)


def _openxr_points(frame: Any) -> list | None:
    if not isinstance(frame, Mapping):
        raise BadFrame(f"expected an object, not {frame!r:.40}")
    joints = frame.get("joints")
    if frame.get("isActive") is False or joints in (None, []):
        return None
    if not isinstance(joints, list) or len(joints) != 26:
        given = len(joints) if isinstance(joints, list) else type(joints).__name__
        raise BadFrame(f"expected 26 joints, {given} given")
    return [_openxr_point(joint) for joint in joints]


def _openxr_point(joint: Any) -> Any:
    if not isinstance(joint, Mapping):
        return point(joint)
    flags = joint.get("locationFlags", _POSITION_VALID)
    if not isinstance(flags, int):
        raise BadFrame(f"locationFlags must be an integer, not {flags!r:.40}")
    return _position(joint.get("pose", joint)) if flags & _POSITION_VALID else point(None)


def _position(pose: Any) -> Any:
    return point(pose["position"] if isinstance(pose, Mapping) and "position" in pose else pose)


def _valid(file: Source, count: int) -> np.ndarray:
    if "valid" not in file.header:
        return np.ones((count, 26), bool)
    valid = np.asarray(file.header["valid"])
    if valid.shape != (count, 26) or valid.dtype.kind not in "biu":
        raise file.error(f"valid must be boolean of shape {(count, 26)}, not {valid.dtype} {valid.shape}")
    return valid.astype(bool)


def _check_palm(file: Source, p: np.ndarray) -> None:
    """The palm comes first, which lies between the wrist and the knuckles."""
    reach = np.linalg.norm(p[:, [_PALM, _WRIST]] - p[:, [_MIDDLE_PROXIMAL]], axis=-1)
    reach = reach[np.isfinite(reach).all(axis=1)]
    if len(reach) and np.median(reach[:, 0] - reach[:, 1]) > 0:
        raise file.error(
            "wrong joint order: joint 0 must be the palm and joint 1 the wrist, but joint 0 is farther from "
            "the middle knuckle (joint 12); swap them"
        )


def _is_webxr(contents: Any) -> bool:
    lists, objects = _kinds(contents)
    return shape_in(contents, "joints")[1:2] in ((25,), (400,)) or objects > lists


def _read_webxr(file: Source, side: str) -> Tracks:
    if not frames_of(file.contents):
        field, p = "joints", file.array("joints", *_shapes(25))
        clock = file.times(len(p))
    else:
        field, clock = "poses", file.times(len(file.frames()), "time", "ms")
        if file.has("poses"):
            p = file.array("poses", (400,))
        else:
            p = file.each(file.frames(), _webxr_points, (25, 3), "joints")
    p, findings = file.positions(field, p, column_major=True)
    return Tracks(p[:, KEYPOINTS_OF_25], clock, world=True, side=file.side(), findings=findings)


def _webxr_points(frame: Any) -> list:
    joints = frame.get("joints") if isinstance(frame, Mapping) else None
    if not isinstance(joints, Mapping):
        raise BadFrame("joints must be an object with the names of XRHandJoint")
    missing = [joint for joint in _WEBXR_JOINTS if joint not in joints]
    if missing:
        raise BadFrame(f"lacks {len(missing)} of 25 joints, such as {missing[0]}")
    return [_position(joints[joint]) for joint in _WEBXR_JOINTS]


def _kinds(contents: Any) -> tuple[int, int]:
    """In how many frames joints are a list, as OpenXR has them, and an object or poses, as WebXR has them."""
    frames = [frame for frame in frames_of(contents) if isinstance(frame, Mapping)]
    lists = sum(isinstance(frame.get("joints"), list) for frame in frames)
    return lists, sum(isinstance(frame.get("joints"), Mapping) or "poses" in frame for frame in frames)


def _shapes(joints: int) -> tuple[tuple[int, ...], ...]:
    return (joints, 3), (joints, 7), (joints, 4, 4), (joints, 16), (joints * 16,)


OPENXR = Format("OpenXR, 26 joints", _SUFFIXES, _is_openxr, _read_openxr)
WEBXR = Format("WebXR, 25 joints", _SUFFIXES, _is_webxr, _read_webxr)
