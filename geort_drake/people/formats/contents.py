"""Accesses the contents of files: tables, arrays by name, and frames that are JSON or pickled objects."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np


class BadFrame(Exception):
    """A single frame cannot be read; the message says what was expected and what was given."""


class Table(NamedTuple):
    """A CSV file.

    Attributes:
        header: names of the columns.
        rows: strings of each row.
    """

    header: list[str]
    rows: list[list[str]]


def frames_of(contents: Any) -> list:
    """Returns the frames of a file: the list that it is, or its list `frames`; otherwise an empty list."""
    frames = contents.get("frames") if isinstance(contents, Mapping) else contents
    return frames if isinstance(frames, list) else []


def any_frame(contents: Any, fits: Callable[[Mapping], bool]) -> bool:
    """Whether `fits` holds for any frame that is an object."""
    return any(fits(frame) for frame in frames_of(contents) if isinstance(frame, Mapping))


def joints_of(frame: Any, field: str, names: Sequence[str]) -> list | None:
    """Returns a frame's joints in the order of `names`, from a list or a mapping by name; None without any.

    Raises:
        BadFrame: joints are missing, or their number is wrong.
    """
    given = frame.get(field) if isinstance(frame, Mapping) else f"in {frame!r:.40}"
    if isinstance(given, Mapping):
        if missing := [name for name in names if name not in given]:
            raise BadFrame(f"{field} lacks {len(missing)} of {len(names)} joints, such as {missing[0]}")
        return [given[name] for name in names]
    if given in (None, []):
        return None
    if not isinstance(given, list) or len(given) != len(names):
        raise BadFrame(f"{field} must contain {len(names)} joints, not {given!r:.60}")
    return given


def shape_in(contents: Any, field: str) -> tuple[int, ...]:
    """Returns the shape of an archive's array; () if there is no such array, or it is not numeric."""
    array = contents.get(field) if isinstance(contents, Mapping) else None
    return array.shape if isinstance(array, np.ndarray) and array.dtype.kind in "fiu" else ()


def point(value: Any) -> Any:
    """Returns [x, y, z] of a point given as such or as {"x": ..., "y": ..., "z": ...}; NaN for null."""
    if value is None:
        return [np.nan] * 3
    return [value.get(axis) for axis in "xyz"] if isinstance(value, Mapping) else value


def empty_frames(values: np.ndarray) -> np.ndarray:
    """Returns (T,) bool: frames of values (T, ...) that are all zero, as some trackers store a lost hand."""
    return (values == 0.0).all(axis=tuple(range(1, values.ndim)))


def description(contents: Any) -> str:
    """Describes a file's contents in a few words."""
    if isinstance(contents, Mapping):
        parts = [
            f"{name if isinstance(name, str) else type(name).__name__:.40}{getattr(value, 'shape', '')}"
            for name, value in contents.items()
        ]
        return ", ".join(parts[:8]) + (", ..." if len(parts) > 8 else "") or "nothing"
    if isinstance(contents, Table):
        return f"columns {', '.join(contents.header[:5])}, ..."
    return type(contents).__name__ + (f" of {len(contents)}" if isinstance(contents, list) else "")


def shape_of(value: Any) -> tuple[int, ...] | None:
    """Returns the shape of a value in a frame; None if its rows differ in length."""
    try:
        return np.shape(value)
    except ValueError:
        return None
