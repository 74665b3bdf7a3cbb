"""The formats of recordings: a function each from a file to times, keypoints and side.

A field that is there is read or refused, never taken for absent; numbers in text count as numbers. A single
frame that cannot be read shows no hand; `read_recording` counts such frames.
"""

import csv
import itertools
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.people.checks import bent_side
from geort_drake.people.keypoints import KEYPOINT_COUNT
from geort_drake.people.recording import SIDES, check_file, load_arrays

NODE_COUNT = 25
# The keypoints among 25 joints: wrist, four of the thumb, then five per finger, of which the first, the
# base of the metacarpal, is no keypoint.
KEYPOINTS_OF_25 = tuple(i for i in range(NODE_COUNT) if i not in (5, 10, 15, 20))

_POINTS = (KEYPOINT_COUNT, 3)


class File(NamedTuple):
    """What a file contains, whatever its kind. Fields without a value are left out.

    Attributes:
        stem: name of the file without suffix.
        fields: what holds for the whole file, by name: the arrays of .npz, that of .npy as "data", the
            columns of .csv as lists of text, or the fields of an object in JSON.
        frames: the fields of each frame of a list in JSON, or of a list called "frames" in an object; a frame
            that cannot be read has none.
    """

    stem: str
    fields: dict[str, Any]
    frames: list[dict[str, Any]]


class Track(NamedTuple):
    """One hand as a file stores it.

    Attributes:
        t: (T,) times, s, NaN where a frame has none; None if the file has none.
        p_WK: (T, 21, 3) keypoints in the file's frame W, in `unit`; NaN where the hand is lost.
        side: side that the file states, or None.
        in_world: whether W is fixed in space, so that the wrist's pose means something.
        unit: m, cm, mm or inch.
        remarks: sentences about what was repaired.
    """

    t: np.ndarray | None
    p_WK: np.ndarray
    side: str | None = None
    in_world: bool = False
    unit: str = "m"
    remarks: tuple[str, ...] = ()


class Format(NamedTuple):
    """One format: description, suffixes of its files, and its functions on a file.

    Attributes:
        recognizes: tells whether a file has this format.
        read: returns the hand of the requested side; raises RecordingError if the meaning is open.
    """

    title: str
    suffixes: tuple[str, ...]
    recognizes: Callable[[File], bool]
    read: Callable[[File, str], Track]


def read_keypoint_array(file: File, side: str) -> Track:
    """Reads arrays of keypoints, such as GeoRT's.

    (T, 21, 3) in .npy, m, in the wrist frame H or any other frame, such as MediaPipe's world landmarks.

    Source: https://github.com/facebookresearch/GeoRT, README.
    """
    return Track(None, array_of(file, "data", _POINTS))


def read_manus(file: File, side: str) -> Track:
    """Reads MANUS raw skeletons.

    `data` (T, 25, 7) of px py pz and a quaternion, m, and Unix `timestamps`, s. Nodes: wrist 0; thumb 1-4
    (CMC, MCP, IP, tip); then five each of index to little finger: metacarpal base, MCP, PIP, DIP, tip.
    Optional `keypoint_ids` (25) give the nodes' order, `chirality` the side.

    Source: https://github.com/mimicrobotics/mimic_retargeter_lab, whose published recordings these are.
    """
    p_WN = array_of(file, "data", (NODE_COUNT, 7))[..., :3]
    try:
        numbers = np.asarray(file.fields.get("keypoint_ids", range(NODE_COUNT))).tolist()
        p_WK = keypoints_of_nodes(p_WN, numbers)
    except (TypeError, ValueError) as error:
        raise RecordingError(f"keypoint_ids {error}") from None
    return Track(times_of(file, len(p_WK)), p_WK, side_of(file.fields), in_world=True)


def keypoints_of_nodes(p_WN: np.ndarray, numbers: Sequence[int] = range(NODE_COUNT)) -> np.ndarray:
    """Returns the 21 keypoints p_WK (..., 21, 3) of a MANUS skeleton's nodes p_WN (..., 25, 3).

    Args:
        p_WN: the nodes, in any frame W and unit.
        numbers: number of each node, a permutation of 0 to 24.

    Raises:
        ValueError: the numbers are no such permutation.
    """
    if not isinstance(numbers, Sequence) or sorted(numbers) != list(range(NODE_COUNT)):
        raise ValueError(f"must be the numbers 0 to {NODE_COUNT - 1} in some order")
    return p_WN[..., np.argsort(numbers), :][..., KEYPOINTS_OF_25, :]


_ELAPSED = "Elapsed_Time_In_Milliseconds"
_CSV_JOINTS = ("Hand", *(f"Thumb_{joint}" for joint in ("CMC", "MCP", "DIP", "TIP"))) + tuple(
    f"{finger}_{joint}"
    for finger in ("Index", "Middle", "Ring", "Pinky")
    for joint in ("MCP", "PIP", "DIP", "TIP")
)
_PALM_ENDS = ("Hand", "Index_CMC", "Pinky_CMC")


def read_manus_csv(file: File, side: str) -> Track:
    """Reads MANUS Core's CSV export.

    `Elapsed_Time_In_Milliseconds` and joint positions. `Hand_X` is documented for Core 2.4 without a unit
    (metres are assumed), `Hand_Position_X` in centimetres in published exports. MANUS documents neither
    axes nor side; the file's name ends with _L or _R. If the fingers bend backwards, the axes are
    left-handed, and x is negated. Without a tracker, the ends of the palm never move.

    Sources: https://docs.manus-meta.com/2.4.0/Software/Rec/Exporting%20csv and
    https://github.com/jeannebelorgey/Metaglove-Ergo-Analysis/tree/main/data
    """
    infix, unit = ("_Position", "cm") if "Thumb_CMC_Position_X" in file.fields else ("", "m")
    columns = [f"{joint}{infix}_{axis}" for joint in _CSV_JOINTS for axis in "XYZ"]
    if missing := [name for name in columns if name not in file.fields]:
        raise RecordingError(
            f"the header lacks {len(missing)} of {len(columns)} columns, such as {missing[0]}"
        )
    p_WK = np.transpose([_cells(file, name) for name in columns]).reshape(-1, *_POINTS)
    t = None
    if _ELAPSED in file.fields:
        t = 1e-3 * stamps_of([cell or None for cell in file.fields[_ELAPSED]], f"column {_ELAPSED}")
    remarks: tuple[str, ...] = ()
    stated = {"_L": "left", "_R": "right"}.get(file.stem[-2:])
    if stated == side and bent_side(p_WK, side) != side:
        p_WK = p_WK * [-1, 1, 1]
        remarks = (
            f"the axes are left-handed: by its name a {side} hand, but its fingers bend backwards; x negated",
        )
    palm = [f"{joint}{infix}_{axis}" for joint in _PALM_ENDS for axis in "XYZ"]
    ends = [_cells(file, name) for name in palm if name in file.fields]
    moves = len(ends) < len(palm) or np.mean([end == np.nanmedian(end) for end in ends]) <= 0.9
    return Track(t, p_WK, stated, bool(moves), unit, remarks)


def _cells(file: File, name: str) -> np.ndarray:
    """Returns a column of numbers (T,); NaN for cells that are empty or cannot be read."""
    return np.array([number_of(cell) for cell in file.fields[name]], dtype=float)


_WORLD = ("worldLandmarks", "hand_world_landmarks", "multi_hand_world_landmarks", "multiHandWorldLandmarks")
_HANDEDNESS = ("handedness", "handednesses", "multi_handedness", "multiHandedness")
_LABEL = ("categoryName", "category_name", "label", "displayName", "display_name")


def read_mediapipe(file: File, side: str) -> Track:
    """Reads MediaPipe's world landmarks, m from the middle of the hand.

    JSON, a list of results or {"frames": [...]}, each with the fields of HandLandmarkerResult:
    `worldLandmarks` (Python: `hand_world_landmarks`) with 21 points per hand seen, `handedness` with one
    category each, and `timestampMs`. An .npz has `world_landmarks` and optionally `t`, s, and
    `handedness`. Many versions label hands as if the image were mirrored, so the side is determined from
    how the fingers bend; the label decides only if they hardly bend.

    Sources: https://ai.google.dev/edge/mediapipe/solutions/vision/hand_landmarker and
    https://github.com/google-ai-edge/mediapipe/issues/1374
    """
    stated = side_of(file.fields) or side
    if file.frames:
        p = np.stack([_mediapipe_hands(frame, stated) for frame in file.frames])
        hands_p_WK = {label: p[:, i] for i, label in enumerate(SIDES) if np.isfinite(p[:, i]).any()}
        if not hands_p_WK:
            raise RecordingError(
                f"no frame has {_WORLD[0]}, 21 points of three numbers, for a labelled hand; image "
                "landmarks are not metric"
            )
    else:
        hands_p_WK = {stated: array_of(file, "world_landmarks", _POINTS)}
    fitting = [label for label, p_WK in hands_p_WK.items() if bent_side(p_WK, label) == side]
    if not fitting:
        (other, *_) = hands_p_WK
        raise RecordingError(f"the file's {other} hand does not bend as a {side} one, which was requested")
    label = max(fitting, key=lambda label: np.isfinite(hands_p_WK[label]).sum())
    remarks: tuple[str, ...] = ()
    if label != side:
        remarks = (
            f"labelled {label}, but the fingers bend as a {side} hand's: read as {side}, because "
            "MediaPipe's labels often assume mirrored images",
        )
    return Track(times_of(file, len(hands_p_WK[label]), 1e-3), hands_p_WK[label], side, remarks=remarks)


def _mediapipe_hands(frame: dict[str, Any], side: str) -> np.ndarray:
    """Returns landmarks (2, 21, 3) of the left and right hand, NaN where unseen or unreadable."""
    points = np.full((2, *_POINTS), np.nan)
    hands = next((frame[field] for field in _WORLD if frame.get(field)), None)
    labels = next((frame[field] for field in _HANDEDNESS if field in frame), None)
    if not isinstance(hands, list) or not (labels is None or isinstance(labels, list)):
        return points
    labels = [side][: len(hands)] if labels is None else [_mediapipe_label(label) for label in labels]
    if len(labels) == len(hands) and set(labels) <= set(SIDES):
        for label, hand in reversed(list(zip(labels, hands, strict=True))):
            landmarks = hand.get("landmark", hand.get("landmarks")) if isinstance(hand, Mapping) else hand
            points[SIDES.index(label)] = points_of(landmarks, KEYPOINT_COUNT)
    return points


def _mediapipe_label(value: Any) -> str:
    while isinstance(value, list) and value:
        value = value[0]
    if isinstance(value, Mapping):
        value = next((value[field] for field in _LABEL if value.get(field)), value)
    return str(value).strip().lower()


_POSITION_VALID = 2
_XR_BONES = ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
_XR_JOINTS = (
    "wrist",
    *(f"thumb-{bone}" for bone in _XR_BONES if bone != "phalanx-intermediate"),
    *(f"{finger}-finger-{bone}" for finger in ("index", "middle", "ring", "pinky") for bone in _XR_BONES),
)


def read_openxr(file: File, side: str) -> Track:
    """Reads the 26 joints of OpenXR; WebXR has 25.

    In m, y up: palm (OpenXR only), wrist, four of the thumb, then five each of index to little finger from
    the metacarpal to the tip. .npz: `joints` (T, J, 3), (T, J, 7) with the position first, (T, J, 4, 4), or
    for WebXR (T, 400) as XRFrame.fillPoses fills them, column by column; optionally `t`, s, `valid` (T,
    J), and `hand` or `handedness`. JSON: {"hand": "right", "frames": [{"time": ns or, for WebXR, ms,
    "joints": a list of XrHandJointLocationEXT, or for WebXR an object by name}]}. A frame whose isActive
    is false, and a joint without the flag POSITION_VALID, are lost.

    Sources: https://registry.khronos.org/OpenXR/specs/1.1/man/html/XrHandJointLocationEXT.html,
    https://www.w3.org/TR/webxr-hand-input-1/ and
    https://developer.mozilla.org/en-US/docs/Web/API/XRFrame/fillPoses
    """
    return _read_xr(file, ("palm", *_XR_JOINTS), 1e-9)


def read_webxr(file: File, side: str) -> Track:
    """Reads the 25 joints of WebXR; see `read_openxr`."""
    return _read_xr(file, _XR_JOINTS, 1e-3)


def _read_xr(file: File, names: tuple[str, ...], unit_s: float) -> Track:
    count = len(names)
    if file.frames:
        p = np.stack([_xr_points(frame, names) for frame in file.frames])
    else:
        joints = array_of(file, "joints", (count, 3), (count, 7), (count, 4, 4), (count * 16,))
        if joints.ndim == 2 or joints.shape[-1] == 4:
            X = joints.reshape(-1, count, 4, 4)
            p = _upright(np.swapaxes(X, 2, 3) if joints.ndim == 2 else X, "joints")[..., :3, 3]
        else:
            p = joints[..., :3]
        if "valid" in file.fields:
            valid = array_of(file, "valid", (count,))
            if len(valid) != len(p):
                raise RecordingError(f"{len(valid)} valid for {len(p)} frames")
            p = np.where((np.nan_to_num(valid) != 0)[..., None], p, np.nan)
    p_WK = p[:, count - NODE_COUNT :][:, KEYPOINTS_OF_25]
    return Track(times_of(file, len(p), unit_s), p_WK, side_of(file.fields, *file.frames), in_world=True)


def _xr_points(frame: dict[str, Any], names: tuple[str, ...]) -> np.ndarray:
    """Returns a frame's joints (J, 3); NaN where they are lost or cannot be read."""
    joints = frame.get("joints")
    if isinstance(poses := frame.get("poses"), list):  # column by column
        joints = [poses[start + 12 : start + 15] for start in range(0, len(poses), 16)]
    elif isinstance(joints, Mapping):
        joints = [_xr_position(joints.get(name)) for name in names]
    elif isinstance(joints, list):
        joints = [_xr_position(joint) for joint in joints]
    active = frame.get("isActive", True) in (True, 1, "true")
    return points_of(joints if active else None, len(names))


def _xr_position(joint: Any) -> Any:
    if isinstance(joint, Mapping):
        flags = number_of(joint.get("locationFlags", _POSITION_VALID))
        if flags is None or not math.isfinite(flags) or not int(flags) & _POSITION_VALID:
            return None
        joint = joint.get("pose", joint)
    return joint["position"] if isinstance(joint, Mapping) and "position" in joint else joint


def read_vision_pro(file: File, side: str) -> Track:
    """Reads transforms of Apple Vision Pro, which avp_stream gives, in .npz.

    `right_fingers` (T, 25 or 27, 4, 4), m, in the wrist's frame: wrist 0, thumb 1-4, then five each of
    index to little finger, from the metacarpal to the tip. Two of 27 joints belong to the forearm, the
    last two or the first two. `right_wrist` (T, 1, 4, 4) or (T, 4, 4) is the wrist in the world. Left
    hands use `left_`. A hand that is not seen has identity matrices everywhere.

    Source: https://github.com/Improbable-AI/VisionProTeleop, README and avp_stream/utils/grpc_utils.py
    """
    names = [name for end in ("fingers", "arm") if (name := f"{side}_{end}") in file.fields]
    field = names[0] if names else f"{side}_fingers"
    X_JK = _upright(array_of(file, field, (25, 4, 4), (27, 4, 4)), field)
    if X_JK.shape[1] == 27:  # the wrist's own transform stays the identity
        moved = np.abs(X_JK[:, [0, 2]] - np.eye(4)).max(axis=(2, 3))
        X_JK = X_JK[:, 2 * int(np.nansum(moved[:, 1]) < np.nansum(moved[:, 0])) :]
    if np.nanmedian(np.abs(X_JK[:, 0] - np.eye(4)).max(axis=(1, 2))) > 1e-3:
        raise RecordingError(
            f"{field} must be joints in the wrist's frame, whose own transform is the identity"
        )
    p_WK, t = X_JK[:, KEYPOINTS_OF_25][..., :3, 3], times_of(file, len(X_JK))
    if f"{side}_wrist" not in file.fields:
        return Track(t, p_WK, side)
    X_WJ = array_of(file, f"{side}_wrist", (1, 4, 4), (4, 4)).reshape(-1, 1, 4, 4)
    if len(X_WJ) != len(p_WK):
        raise RecordingError(f"{len(X_WJ)} {side}_wrist for {len(p_WK)} frames")
    X_WJ = _upright(X_WJ, f"{side}_wrist")[:, 0]
    R_WJ = X_WJ[:, :3, :3]
    skew = np.abs(R_WJ @ np.swapaxes(R_WJ, 1, 2) - np.eye(3)).max(axis=(1, 2))
    if not np.nanmedian(skew) < 1e-2 or np.nanmedian(np.linalg.det(np.nan_to_num(R_WJ))) < 0:
        raise RecordingError(f"{side}_wrist must be rotations, which neither mirror nor scale")
    p_WK = (
        np.where((skew < 1e-2)[:, None, None], p_WK @ np.swapaxes(R_WJ, 1, 2), np.nan) + X_WJ[:, None, :3, 3]
    )
    return Track(t, p_WK, side, in_world=True)


def _upright(X: np.ndarray, field: str) -> np.ndarray:
    """Returns transforms (T, J, 4, 4) with the translation in the last column, transposed if needed."""
    known = np.isfinite(X).all(axis=(1, 2, 3)) & (X != 0).any(axis=(1, 2, 3))
    end = np.array([0.0, 0.0, 0.0, 1.0])
    upright = np.isclose(X[..., 3, :], end, atol=1e-5).all(axis=(1, 2))
    turned = np.isclose(X[..., :, 3], end, atol=1e-5).all(axis=(1, 2))
    if (known & turned & ~upright).sum() > (known & upright & ~turned).sum():
        X, upright = np.swapaxes(X, -1, -2), turned
    if (known & ~upright).sum() > 0.5 * known.sum():
        raise RecordingError(f"{field} must be rigid transforms, whose last row is 0 0 0 1")
    return np.where((known & upright)[:, None, None, None], X, np.nan)


def _xr_count(file: File) -> int:
    """Number of joints of an XR file: 26, 25, or another one if it is none."""
    if "joints" in file.fields:
        try:
            width = (*np.shape(file.fields["joints"])[1:], 0)[0]
        except ValueError:  # lists of different lengths
            return 0
        return {26 * 16: 26, 25 * 16: 25}.get(width, width)
    lists = sum(isinstance(frame.get("joints"), list) for frame in file.frames)
    objects = sum(isinstance(frame.get("joints"), Mapping) or "poses" in frame for frame in file.frames)
    return 0 if lists == objects == 0 else 26 if lists > objects else 25


def _has(*names: str) -> Callable[[File], bool]:
    return lambda file: any(name in place for place in (file.fields, *file.frames) for name in names)


_XR = (".json", ".jsonl", ".npz")
_AVP_FIELDS = [f"{side}_{field}" for side in SIDES for field in ("fingers", "arm")]
# In the order of detection: if several formats fit, the first is used.
FORMATS: dict[str, Format] = {
    "manus": Format("raw MANUS skeleton, 25 nodes", (".npz",), _has("data"), read_manus),
    "manus_csv": Format(
        "MANUS Core's CSV export",
        (".csv",),
        lambda file: any("Thumb_CMC_" in name for name in file.fields),
        read_manus_csv,
    ),
    "openxr": Format("OpenXR, 26 joints", _XR, lambda file: _xr_count(file) == 26, read_openxr),
    "webxr": Format("WebXR, 25 joints", _XR, lambda file: _xr_count(file) == 25, read_webxr),
    "vision_pro": Format("Apple Vision Pro, transforms", (".npz",), _has(*_AVP_FIELDS), read_vision_pro),
    "geort": Format("GeoRT, 21 keypoints in any frame", (".npy",), _has("data"), read_keypoint_array),
    "mediapipe": Format(
        "MediaPipe, 21 world landmarks",
        _XR,
        _has("world_landmarks", *_WORLD, "landmarks"),
        read_mediapipe,
    ),
}


# The names under which files may state times and the side.
TIME_FIELDS = ("t", "timestamps", "timestamp", "time", "timestampMs", "timestamp_ms")
_SIDE_FIELDS = ("side", "chirality", "handedness", "hand")
# Names of other fields that say when frames were taken: one value a frame, or one rate for all.
_CLOCK_NAMES = re.compile(r"time|stamp|clock", re.IGNORECASE)
_RATE_NAMES = re.compile(r"fps|(frame|sampl\w*)_?rate|rate_?hz|^(rate|hz|frequency)$", re.IGNORECASE)
_MAX_NUMBER = 1e300  # larger ones are none


def load(path: Path) -> File:
    """Reads a file by its suffix; an unreadable line of JSON becomes a frame without fields.

    Raises:
        RecordingError: the file is missing, too large or malformed; the message does not name it.
    """
    suffix = path.suffix.lower()
    if suffix in (".npy", ".npz"):
        # A single number or word is no array.
        arrays = load_arrays(path).items()
        fields = {name: array if array.ndim else array.item() for name, array in arrays}
        return File(path.stem, fields, [])
    check_file(path)
    if suffix not in (".csv", ".json", ".jsonl"):
        raise RecordingError(f"recordings are .npz, .npy, .json, .jsonl or .csv files, not '{suffix}'")
    try:
        text = path.read_text("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordingError(f"not a text file in UTF-8 ({error})") from None
    if suffix == ".csv":
        return File(path.stem, _columns(text), [])
    if suffix == ".jsonl":
        return File(path.stem, {}, [_fields(_parsed(line)) for line in text.splitlines() if line.strip()])
    try:
        contents = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"not JSON: {error}") from None
    fields = _fields(contents)
    frames = contents if isinstance(contents, list) else fields.get("frames")
    return File(path.stem, fields, [_fields(frame) for frame in frames] if isinstance(frames, list) else [])


def _columns(text: str) -> dict[str, list[str]]:
    """Returns the columns of a table by their names."""
    lines = [line for line in text.splitlines() if line.strip(",;\t ")]
    if not lines:
        raise RecordingError("the table is empty")
    header, *rows = csv.reader(lines, delimiter=max(",;\t", key=lines[0].count))
    names = [name.strip() for name in header]
    # Numbers are no names: a table without a header matches no format, which tells more.
    if twice := [name for name in names if name[:1].isalpha() and names.count(name) > 1]:
        raise RecordingError(f"the header has the column {twice[0]} more than once")
    rows = [[cell.strip() for cell in row[: len(names)]] for row in rows]
    return {name: cells for name, *cells in itertools.zip_longest(names, *rows, fillvalue="")}


def _parsed(line: str) -> Any:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


def _fields(contents: Any) -> dict[str, Any]:
    """Returns the fields of an object in JSON that have a value; none of anything else."""
    fields = contents.items() if isinstance(contents, Mapping) else ()
    return {name: value for name, value in fields if value is not None}


def array_of(file: File, field: str, *shapes: tuple[int, ...]) -> np.ndarray:
    """Returns a field as an array of floats (T, *shape), one of the shapes."""
    if field not in file.fields:
        raise RecordingError(f"lacks {field}; it contains {', '.join(file.fields) or 'no fields'}")
    expected = " or ".join(f"({', '.join(['T', *map(str, shape)])})" for shape in shapes)
    expected = f"{field} must be numbers of shape {expected}"
    try:
        array = np.asarray(file.fields[field])
        if array.dtype.kind in "US":
            array = array.astype(float)
    except ValueError as error:
        raise RecordingError(f"{expected}: {error}") from None
    if array.ndim == 0 or array.shape[1:] not in shapes or array.dtype.kind not in "fiub":
        raise RecordingError(f"{expected}, not {array.dtype} {array.shape}")
    return array.astype(float)


def times_of(file: File, count: int, unit_s: float = 1.0) -> np.ndarray | None:
    """Returns times (count,), s, or None if the file has none.

    Args:
        file: the file.
        count: number of frames.
        unit_s: unit of times in JSON, s; those of an archive are in s.

    Raises:
        RecordingError: a time is there but is no number; names field and frame.
    """
    fields = [
        name for name in TIME_FIELDS if name in file.fields or any(name in frame for frame in file.frames)
    ]
    if not fields:
        return None
    field = fields[0]
    values = file.fields[field] if field in file.fields else [frame.get(field) for frame in file.frames]
    if isinstance(values, np.ndarray) and values.dtype.kind not in "Mm":  # dates are no numbers
        values = values.tolist()
    if not isinstance(values, list):
        raise RecordingError(f"{field}: times must be numbers, one per frame, not {values!r:.60}")
    if len(values) != count:
        raise RecordingError(f"{len(values)} {field} for {count} frames")
    return (unit_s if file.frames else 1.0) * stamps_of(values, field)


def stamps_of(values: Sequence[Any], field: str) -> np.ndarray:
    """Returns times (T,) as floats; NaN for None and what is not finite. Large integers lose their origin.

    Nanoseconds since an epoch exceed a double's resolution, so integers are subtracted first.
    """
    numbers = []
    for i, value in enumerate(values):
        if (number := number_of(math.nan if value is None else value)) is None:
            raise RecordingError(f"{field}[{i}]: times must be numbers, not {value!r:.60}")
        numbers.append(number)
    origin = next((number for number in numbers if isinstance(number, int) and abs(number) >= 2**53), 0)
    return np.array([float(number - origin) for number in numbers])


def unread_clock(file: File, count: int) -> str | None:
    """Returns the name of a field that says when the frames were taken but is not read, or None.

    Args:
        file: a file in which `times_of` finds no times.
        count: number of frames.
    """
    per_frame = [
        name
        for name, value in file.fields.items()
        if isinstance(value, list | np.ndarray) and len(value) == count
    ]
    per_frame += [name for frame in file.frames for name in frame]
    clocks = [name for name in per_frame if _CLOCK_NAMES.search(name)]
    rates = [name for name in [*file.fields, *per_frame] if _RATE_NAMES.search(name)]
    return next(iter([*clocks, *rates]), None)


def side_of(*places: Mapping[str, Any]) -> str | None:
    """Returns the side that the fields of a file, or of its frames, state; or None.

    Raises:
        RecordingError: a side is there but is neither left nor right, or there are both.
    """
    sides: dict[str, str] = {}
    for place in places:
        field = next((name for name in _SIDE_FIELDS if name in place), None)
        if field is None:
            continue
        side = str(place[field]).strip().lower()
        side = {"l": "left", "r": "right"}.get(side, side)
        if side not in SIDES:
            raise RecordingError(f"{field} '{side:.40}' is none of: {', '.join(SIDES)}")
        sides.setdefault(side, field)
    if len(sides) > 1:
        stated = " and ".join(f"{name} ({side})" for side, name in sides.items())
        raise RecordingError(f"{stated} state both sides; give one hand per file")
    return next(iter(sides), None)


def points_of(values: Any, count: int) -> np.ndarray:
    """Returns points (count, 3), given as lists or as objects with x, y, z; NaN for None.

    All are NaN if one of them cannot be read.
    """
    lost = np.full((count, 3), np.nan)
    try:
        points = np.array([_coordinates(value) for value in values], dtype=float)
    except (TypeError, ValueError, KeyError, OverflowError):
        return lost
    return points if points.shape == lost.shape else lost


def _coordinates(point: Any) -> Any:
    if point is None:
        return [math.nan] * 3
    return [point[axis] for axis in "xyz"] if isinstance(point, Mapping) else point[:3]


def number_of(value: Any) -> int | float | None:
    """Returns a number, also from text, without rounding integers; None for anything else.

    What is not finite, or too large for a double, is NaN.
    """
    if isinstance(value, str):
        for kind in (int, float):
            try:
                value = kind(value)
            except ValueError:
                continue
            break
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return value if abs(value) < _MAX_NUMBER else math.nan
