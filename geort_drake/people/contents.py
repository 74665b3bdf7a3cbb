"""The contents of a recording's file, and typed access to them.

Contents are a dict of arrays (.npz, or .npy under the name "data"), a `Table` (.csv), or the objects of a
JSON file. Numbers in text count as numbers. A field that is there but cannot be read is refused; what belongs
to a single frame becomes NaN instead.
"""

import csv
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.people.recording import SIDES, check_file, load_arrays

_TIME_FIELDS = ("t", "timestamps", "timestamp", "time", "timestampMs", "timestamp_ms")
_SIDE_FIELDS = ("side", "chirality", "handedness", "hand")


class Table(NamedTuple):
    """A CSV file: its rows of text, header first, and its name without suffix."""

    rows: list[list[str]]
    stem: str


def load(path: Path) -> Any:
    """Returns a file's contents by its suffix; an unreadable line of JSON becomes None."""
    suffix = path.suffix.lower()
    if suffix in (".npy", ".npz"):
        return load_arrays(path)
    check_file(path)
    if suffix not in (".csv", ".json", ".jsonl"):
        raise RecordingError(
            f"{path}: recordings are .npz, .npy, .json, .jsonl or .csv files, not '{suffix}'"
        )
    try:
        text = path.read_text("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: not a text file in UTF-8 ({error})") from None
    if suffix == ".csv":
        lines = [line for line in text.splitlines() if line.strip(",;\t ")]
        if not lines:
            raise RecordingError(f"{path}: the table is empty")
        return Table(list(csv.reader(lines, delimiter=max(",;\t", key=lines[0].count))), path.stem)
    if suffix == ".jsonl":
        return [_parsed(line) for line in text.splitlines() if line.strip()]
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{path}: not JSON: {error}") from None


def _parsed(line: str) -> Any:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


def frames_of(contents: Any) -> list:
    """Returns the frames of JSON: the list that it is, or its list `frames`; otherwise an empty list."""
    frames = contents.get("frames") if isinstance(contents, Mapping) else contents
    return frames if isinstance(frames, list) else []


def array_of(contents: Any, field: str, *shapes: tuple[int, ...]) -> np.ndarray:
    """Returns an archive's array of floats (T, *shape), one of the shapes."""
    if not isinstance(contents, Mapping) or field not in contents:
        names = ", ".join(map(str, contents)) if isinstance(contents, Mapping) else type(contents).__name__
        raise RecordingError(f"lacks {field}; it contains {names or 'nothing'}")
    array = np.asarray(contents[field])
    if array.dtype.kind in "US":
        array = numbers_of(array.tolist(), field)
    if array.ndim == 0 or array.shape[1:] not in shapes or array.dtype.kind not in "fiub":
        expected = " or ".join(f"({', '.join(['T', *map(str, shape)])})" for shape in shapes)
        raise RecordingError(f"{field} must be numbers of shape {expected}, not {array.dtype} {array.shape}")
    return array.astype(float)


def times_of(contents: Any, count: int, unit_s: float = 1.0) -> np.ndarray | None:
    """Returns times (count,), s, or None if the file has none.

    Args:
        contents: of the file.
        count: number of frames.
        unit_s: unit of the times in frames, s; an archive's array is in s.

    Raises:
        RecordingError: a time is there but is no number; names field and frame.
    """
    frames = frames_of(contents)
    fields = [
        name
        for name in _TIME_FIELDS
        if (isinstance(contents, Mapping) and name in contents)
        or any(isinstance(frame, Mapping) and frame.get(name) is not None for frame in frames)
    ]
    if not fields:
        return None
    (field, *_) = fields
    if isinstance(contents, Mapping) and field in contents:
        values, unit_s = contents[field], unit_s if frames else 1.0
        values = values.tolist() if isinstance(values, np.ndarray) else values
        if np.asarray(contents[field]).dtype.kind in "Mm" or not isinstance(values, list):
            raise RecordingError(
                f"{field}: times must be numbers, one per frame, not {contents[field]!r:.60}"
            )
    else:
        values = [frame.get(field) if isinstance(frame, Mapping) else None for frame in frames]
    if len(values) != count:
        raise RecordingError(f"{len(values)} {field} for {count} frames")
    return unit_s * stamps_of(values, field)


def stamps_of(values: Sequence[Any], field: str) -> np.ndarray:
    """Returns times (T,) as floats; NaN for None and what is not finite. Large integers lose their origin.

    Nanoseconds since an epoch exceed a double's resolution, so integers are subtracted first.
    """
    numbers: list[Any] = []
    for i, value in enumerate(values):
        number = exact_number(value)
        if number is None and value is not None:
            raise RecordingError(f"{field}[{i}]: times must be numbers, not {value!r:.60}")
        numbers.append(number)
    known = [number for number in numbers if number is not None and abs(number) < 1e300]
    start = sorted(known)[len(known) // 2] if known else 0
    if numbers and numbers[0] in known and abs(numbers[0] - start) < 1e300:
        start = numbers[0]
    origin = float(start) if isinstance(start, float) or abs(start) < 2**53 else 0.0
    shifted = [math.nan if n is None or not abs(n) < 1e300 else float(n - start) for n in numbers]
    return np.array(shifted) + origin


def exact_number(value: Any) -> int | float | None:
    """Returns a number, also from text, without rounding integers; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    if isinstance(value, str):
        for kind in (int, float):
            try:
                return kind(value)
            except ValueError:
                pass
        return None
    return value


def side_of(contents: Any) -> str | None:
    """Returns the side that a file states, or None; raises RecordingError if it states neither."""
    field = next((name for name in _SIDE_FIELDS if isinstance(contents, Mapping) and name in contents), None)
    if field is None:
        return None
    side = str(contents[field]).strip().lower()
    side = {"l": "left", "r": "right"}.get(side, side)
    if side not in SIDES:
        raise RecordingError(f"{field} '{side:.40}' is none of: {', '.join(SIDES)}")
    return side


def points_of(values: Any, count: int) -> np.ndarray:
    """Returns points (count, 3) given as lists or as objects with x, y, z; NaN for unreadable ones."""
    points = np.full((count, 3), np.nan)
    if not isinstance(values, list) or len(values) != count:
        return points
    for i, value in enumerate(values):
        coordinates = [value.get(axis) for axis in "xyz"] if isinstance(value, Mapping) else value
        if isinstance(coordinates, list) and len(coordinates) >= 3:
            points[i] = [number_of(number) for number in coordinates[:3]]
    return points


def number_of(value: Any) -> float:
    number = exact_number(value)
    return math.nan if number is None or not abs(number) < 1e300 else float(number)


def numbers_of(values: Any, field: str | None = None) -> np.ndarray:
    """Returns nested lists of numbers, also in text, as an array; others are NaN, or refused by `field`."""
    if isinstance(values, list):
        try:
            return np.array([numbers_of(value, field) for value in values])
        except ValueError:
            return np.array(math.nan)
    if field is not None and exact_number(values) is None:
        raise RecordingError(f"{field} must be numbers, not {values!r:.60}")
    return np.array(number_of(values))
