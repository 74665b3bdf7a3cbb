"""What the readers of all formats share: their result, and the checked reading of fields."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.people.checks.findings import Finding, Severity
from geort_drake.people.checks.timing import TIME_UNITS_S
from geort_drake.people.recording import SIDES

# Of hands with 25 joints: wrist, four of the thumb, then five per finger whose first, the base of the
# metacarpal, has no counterpart among the 21 keypoints.
KEYPOINTS_OF_25 = tuple(i for i in range(25) if i not in (5, 10, 15, 20))

_TIMES = ("t", "timestamps", "time")
_SIDES = ("side", "chirality", "handedness", "hand")


@dataclasses.dataclass(frozen=True, eq=False)
class Clock:
    """The times of a file's frames, and where they stood.

    Attributes:
        t: (T,) times, s.
        field: of the file.
        unit: of the file's numbers, one of `TIME_UNITS_S`.
    """

    t: np.ndarray
    field: str
    unit: str = "s"


@dataclasses.dataclass(frozen=True, eq=False)
class Tracks:
    """The keypoints of one hand as a file gives them.

    Attributes:
        p_WK: (T, 21, 3) keypoints in the file's frame W and unit; NaN where the hand was lost.
        clock: the times of the frames, or None where the file has none.
        world: whether W stays in place, so that the wrist's pose in it is worth keeping.
        side: which hand the file says it is, or None.
        unit: of p_WK, where nobody says another.
        findings: what the reader saw or repaired.
        metadata: what else the file says; JSON types only.
    """

    p_WK: np.ndarray
    clock: Clock | None = None
    world: bool = False
    side: str | None = None
    unit: str = "m"
    findings: Sequence[Finding] = ()
    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def numbers(name: str, field: str, value: Any, *shapes: tuple[int, ...]) -> np.ndarray:
    """`value` as floats (T, ...) if its shape after the first axis is one of `shapes`.

    Raises:
        RecordingError: with the shapes wanted and the shape and type given.
    """
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different length
        array = np.asarray(value, dtype=object)
    if array.ndim == 0 or array.shape[1:] not in shapes or array.dtype.kind not in "fiu":
        wanted = " or ".join(f"({', '.join(['T', *map(str, shape)])})" for shape in shapes)
        raise RecordingError(
            f"{name}: {field} must hold numbers of shape {wanted}, not {array.dtype} {array.shape}"
        )
    return array.astype(float)


def shape_of(value: Any) -> tuple[int, ...] | None:
    """The shape of what a pickle holds in a frame; None where rows differ in length."""
    try:
        return np.shape(value)
    except ValueError:
        return None


def times(name: str, arrays: Mapping[str, Any], frames: int) -> Clock | None:
    """Times, s, of an archive that may hold them as t, timestamps or time; one for each frame."""
    field = next((field for field in _TIMES if field in arrays), None)
    if field is None:
        return None
    t = numbers(name, field, arrays[field], ())
    if len(t) != frames:
        raise RecordingError(f"{name}: {len(t)} {field} for {frames} frames of data")
    return Clock(t, field)


def side_of(name: str, fields: Mapping[str, Any]) -> str | None:
    """The side that a file states in a field side, chirality, handedness or hand; None if it does not.

    Raises:
        RecordingError: it states neither left nor right.
    """
    field = next((field for field in _SIDES if field in fields), None)
    if field is None:
        return None
    side = str(fields[field]).strip().lower()
    if side not in SIDES:
        raise RecordingError(f"{name}: {field} '{side}' is none of: {', '.join(SIDES)}")
    return side


def frames_of(name: str, contents: Any) -> list[dict]:
    """The frames of a JSON file: a list of objects, or an object with such a list named frames."""
    frames = contents.get("frames") if isinstance(contents, dict) else contents
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise RecordingError(
            f"{name}: a list of frames is wanted, or an object with such a list named frames"
        )
    return frames


def point(name: str, where: str, value: Any) -> list[float]:
    """Three coordinates given as [x, y, z] or {"x": ..., "y": ..., "z": ...}; NaN for null."""
    if value is None:
        return [np.nan] * 3
    xyz = [value.get(axis) for axis in "xyz"] if isinstance(value, dict) else value
    if not isinstance(xyz, list) or len(xyz) != 3 or not all(map(is_number, xyz)):
        raise RecordingError(f"{name}: {where} must be a point of three numbers x, y, z, not {value!r:.60}")
    return [float(x) for x in xyz]


def json_times(name: str, frames: Sequence[dict], field: str, unit: str) -> Clock | None:
    """Times from the same field of every frame, which counts in one of `TIME_UNITS_S`; None without any."""
    stamps: list[Any] = [frame.get(field) for frame in frames]
    if all(stamp is None for stamp in stamps):
        return None
    for i, stamp in enumerate(stamps):
        if not is_number(stamp):
            raise RecordingError(f"{name}: frame {i}: {field} must be a number, not {stamp!r:.40}")
    # Nanoseconds since an epoch exceed what a double resolves, so the start is taken off first.
    t = np.array([(stamp - stamps[0]) * TIME_UNITS_S[unit] for stamp in stamps])
    return Clock(t, field, unit)


def is_number(value: Any) -> bool:
    """Whether a value of a JSON file is a number that a float holds; JSON's whole numbers have no bound."""
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) < 1 << 1000
    return isinstance(value, float)


def joint_positions(
    name: str, field: str, value: Any, joints: int, column_major: bool = False
) -> tuple[np.ndarray, list[Finding]]:
    """Positions (T, J, 3) of joints given as points, poses or transforms.

    Args:
        name: the file.
        field: of the file.
        value: (T, J, 3) points; (T, J, 7) `px py pz` and a quaternion; (T, J, 4, 4) transforms; or
            (T, J, 16) and (T, J * 16), the transforms' numbers.
        joints: J.
        column_major: whether transforms in one row of numbers stand column by column, as graphics APIs
            give them.
    """
    shapes = ((joints, 3), (joints, 7), (joints, 4, 4), (joints, 16), (joints * 16,))
    array = numbers(name, field, value, *shapes)
    if array.shape[-1] == 3:
        return array, []
    if array.shape[-1] == 7:
        check_quaternions(name, field, array)
        return array[..., :3], []
    # Only where numbers were left in a row is their order the graphics API's.
    X, findings = transforms(
        name, field, array.reshape(len(array), joints, 4, 4), column_major and array.ndim < 4
    )
    return X[..., :3, 3], findings


def transforms(
    name: str, field: str, X: np.ndarray, column_major: bool = False
) -> tuple[np.ndarray, list[Finding]]:
    """Homogeneous transforms (..., 4, 4) with the translation in the last column, turned if need be.

    Raises:
        RecordingError: neither the last row nor the last column is 0 0 0 1.
    """
    end = np.array([0.0, 0.0, 0.0, 1.0])
    known = X[~empty_frames(X)]
    known = known[np.isfinite(known).all(axis=(-1, -2))]
    in_column = np.allclose(known[..., 3, :], end, atol=1e-5)
    in_row = np.allclose(known[..., :, 3], end, atol=1e-5)
    if not (in_column or in_row):
        raise RecordingError(
            f"{name}: {field} must hold rigid transforms, whose last row is 0 0 0 1, not "
            f"{np.round(known[0, 3], 3).tolist() if len(known) else 'NaN'}"
        )
    if in_row in (in_column, column_major):  # a matrix without translation may be either
        return (np.swapaxes(X, -1, -2) if in_row and not in_column else X), []
    wanted, given = ("columns", "rows") if column_major else ("rows", "columns")
    finding = Finding(
        "axes",
        Severity.WARNING,
        f"transforms are transposed: their numbers were to stand in {wanted} and stand in {given}",
        field,
        "read the other way, which their zeros and ones prove right",
    )
    return (np.swapaxes(X, -1, -2) if in_row else X), [finding]


def empty_frames(values: np.ndarray) -> np.ndarray:
    """(T,) which frames of values (T, ...) are zeros alone, as some trackers store frames without a hand."""
    return (values == 0.0).all(axis=tuple(range(1, values.ndim)))


def check_quaternions(name: str, field: str, poses: np.ndarray) -> None:
    """Looks whether poses (T, J, 7) are positions and then unit quaternions, where a frame has any."""
    size = np.linalg.norm(poses[..., 3:], axis=-1)
    size[empty_frames(poses)] = 1.0
    if np.nanmax(np.abs(size - 1.0), initial=0.0) < 1e-2:
        return
    first = np.nanmax(np.abs(np.linalg.norm(poses[..., :4], axis=-1) - 1.0), initial=0.0) < 1e-2
    frame, joint = np.unravel_index(int(np.nanargmax(np.abs(size - 1.0))), size.shape)
    raise RecordingError(
        f"{name}: {field} must hold px py pz and then a unit quaternion, but the last four numbers of frame "
        f"{frame}, joint {joint} have norm {size[frame, joint]:.3g}"
        + ("; the quaternion stands first: move the position before it" if first else "")
    )
