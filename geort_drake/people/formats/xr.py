"""Hand joints of OpenXR (26) and WebXR (25), in .npz or JSON.

OpenXR's order: palm, wrist, four of the thumb, then five each of index, middle, ring and little finger from
the metacarpal to the tip. Each joint is the base of the bone that names it. WebXR's order is the same without
the palm. Positions are in m, in a space with y up.

OpenXR .npz: `joints` (T, 26, 3), (T, 26, 7) with `px py pz qx qy qz qw`, or (T, 26, 4, 4); optionally `t`,
s, `valid` (T, 26) and `hand`. JSON: `{"hand": "right", "frames": [{"time": ns, "joints": [...]}]}`, each
joint an XrHandJointLocationEXT. If `isActive` is false or there are no joints, the hand is lost.
Source: https://registry.khronos.org/OpenXR/specs/1.1/man/html/XrHandJointEXT.html and
https://registry.khronos.org/OpenXR/specs/1.1/man/html/XrHandJointLocationEXT.html

WebXR .npz: `joints` (T, 25, 3), (T, 25, 7), or (T, 400) as `XRFrame.fillPoses` fills them,
column-major; optionally `t`, s, and `handedness`. JSON: `{"handedness": "right", "frames": [{"time": ms,
"joints": {"wrist": {...}, ...}}]}`, each joint with `position` or null; or `poses`, 400 numbers.
Source: https://www.w3.org/TR/webxr-hand-input-1/ and
https://developer.mozilla.org/en-US/docs/Web/API/XRFrame/fillPoses
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from geort_drake.people.formats.contents import BadFrame, frames_of, joints_of, point, shape_in
from geort_drake.people.formats.source import KEYPOINTS_OF_25, Format, Source, Tracks

_SUFFIXES = (".json", ".jsonl", ".npz")
_POSITION_VALID = 2  # XR_SPACE_LOCATION_POSITION_VALID_BIT
_BONES = ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
_JOINTS = (
    "palm",
    "wrist",
    *(f"thumb-{bone}" for bone in _BONES if bone != "phalanx-intermediate"),
    *(f"{finger}-finger-{bone}" for finger in ("index", "middle", "ring", "pinky") for bone in _BONES),
)


def _is_openxr(contents: Any) -> bool:
    lists, objects = _count_kinds(contents)
    return shape_in(contents, "joints")[1:2] in ((26,), (416,)) or lists > objects


def _is_webxr(contents: Any) -> bool:
    lists, objects = _count_kinds(contents)
    return shape_in(contents, "joints")[1:2] in ((25,), (400,)) or objects > lists


def _count_kinds(contents: Any) -> tuple[int, int]:
    """Counts frames with a list of joints (OpenXR), and those with an object of joints or poses (WebXR)."""
    frames = [frame for frame in frames_of(contents) if isinstance(frame, Mapping)]
    lists = sum(isinstance(frame.get("joints"), list) for frame in frames)
    return lists, sum(isinstance(frame.get("joints"), Mapping) or "poses" in frame for frame in frames)


def _read_openxr(file: Source, side: str) -> Tracks:
    return _read(file, _JOINTS, 1e-9, column_major=False)


def _read_webxr(file: Source, side: str) -> Tracks:
    return _read(file, _JOINTS[1:], 1e-3, column_major=True)


def _read(file: Source, names: tuple[str, ...], unit_s: float, column_major: bool) -> Tracks:
    count, field = len(names), "poses" if file.has("poses") else "joints"
    if frames_of(file.contents) and field == "joints":
        p = file.each(frames_of(file.contents), lambda frame: _points(frame, names), (count, 3), field)
    else:
        shapes = ((count, 3), (count, 7), (count, 4, 4), (count, 16), (count * 16,))
        p = file.array(field, *shapes)
    p = file.positions(field, p, column_major)
    if "valid" in file.header:
        p = np.where(file.array("valid", (count,), count=len(p))[..., None] != 0, p, np.nan)
    p_WK = p[:, count - 25 :][:, KEYPOINTS_OF_25]
    return Tracks(p_WK, file.times(len(p), unit_s), world=True, side=file.side())


def _points(frame: Any, names: tuple[str, ...]) -> list | None:
    if isinstance(frame, Mapping) and frame.get("isActive") is False:
        return None
    joints = joints_of(frame, "joints", names)
    return joints and [_point(joint) for joint in joints]


def _point(joint: Any) -> Any:
    """Returns the position of a joint, from the joint or its pose; NaN if its flags mark it as lost."""
    if isinstance(joint, Mapping):
        flags = joint.get("locationFlags", _POSITION_VALID)
        if not isinstance(flags, int):
            raise BadFrame(f"locationFlags must be an integer, not {flags!r:.40}")
        joint = joint.get("pose", joint) if flags & _POSITION_VALID else None
    return point(joint["position"] if isinstance(joint, Mapping) and "position" in joint else joint)


OPENXR = Format("OpenXR, 26 joints", _SUFFIXES, _is_openxr, _read_openxr)
WEBXR = Format("WebXR, 25 joints", _SUFFIXES, _is_webxr, _read_webxr)
