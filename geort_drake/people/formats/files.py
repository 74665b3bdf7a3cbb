"""Reads a file's contents by its suffix, before its format is known."""

import csv
import itertools
import json
import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from geort_drake.errors import RecordingError
from geort_drake.people.checks.findings import FrameFaults
from geort_drake.people.formats.contents import Table
from geort_drake.people.formats.source import UNREADABLE, Source
from geort_drake.people.formats.unpickling import ForbiddenPickle, load_plain
from geort_drake.people.recording import check_file, load_arrays

_MAX_REPLACED = 1e-3  # largest fraction of a text's characters that are not UTF-8


def load(path: Path) -> Source:
    """Reads a file, or a folder of pickles with one frame each. Damaged frames become {} with a fault.

    Raises:
        RecordingError: the file is missing or too large, its suffix is unknown, or its contents do not fit
            the suffix.
    """
    faults = FrameFaults()
    if path.is_dir():
        return Source(str(path), _load_folder(path, faults), faults)
    check_file(path)
    load_suffix = _LOADERS.get(path.suffix.lower())
    if load_suffix is None:
        raise RecordingError(f"{path}: recordings are read from {', '.join(_LOADERS)}, not '{path.suffix}'")
    return Source(str(path), load_suffix(path, faults), faults)


def _load_folder(path: Path, faults: FrameFaults) -> list:
    files = sorted(path.glob("*.pkl"))
    if not files:
        raise RecordingError(
            f"{path}: a folder without .pkl files; a recording is a file, or a folder with a .pkl per frame"
        )
    for file in files:
        check_file(file)
    return _frames(files, load_plain, faults)


def _load_json_lines(path: Path, faults: FrameFaults) -> list:
    return _frames([line for line in _text(path).splitlines() if line.strip()], _parsed, faults)


def _frames(sources: Sequence[Any], load_frame: Callable[[Any], Any], faults: FrameFaults) -> list:
    """Loads one frame from each source; {} and a fault if it cannot be read."""
    frames: list = []
    for i, source in enumerate(sources):
        try:
            frames.append(load_frame(source))
        except RecordingError as error:
            if isinstance(error.__cause__, ForbiddenPickle):
                raise
            faults.add(UNREADABLE, [i], str(error))
            frames.append({})
    return frames


def _parsed(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"not JSON: {error}") from None


def _load_table(path: Path, faults: FrameFaults) -> Table:
    lines = [line for line in _text(path).splitlines() if line.strip(",;\t \0")]
    if not lines:
        raise RecordingError(f"{path}: the table is empty")
    delimiter = max(",;\t", key=lines[0].count)
    rows = []
    for line in lines:
        try:
            rows.append(next(csv.reader([line], delimiter=delimiter)))
        except csv.Error:  # a cell is too large; a row without cells is a bad frame
            rows.append([])
    return Table([name.strip() for name in rows[0]], rows[1:])


def _load_json(path: Path, faults: FrameFaults) -> Any:
    text = _text(path)
    try:
        return _parsed(text)
    except RecordingError as error:
        contents = _damaged_json(text, faults)
        if contents is None:
            raise RecordingError(f"{path}: {error}") from None
        return contents


def _damaged_json(text: str, faults: FrameFaults) -> Any:
    """Salvages a list of frames, or an object with one, from damaged or truncated JSON, or returns None."""
    head = re.match(r'\s*(\{[^[]*"frames"\s*:\s*)?\[', text)
    if head is None:
        return None
    found: list[dict] = []  # the readable objects, and {} for each unreadable stretch
    size: Counter[str] = Counter()  # total length of the objects, by their first key
    end = head.end()
    while (start := text.find("{", end)) >= 0:
        if text[end:start].strip(", \r\n\t"):
            found.append({})
        try:
            value, end = json.JSONDecoder().raw_decode(text, start)
            size[next(iter(value), "")] += end - start
        except (ValueError, RecursionError):
            value, end = {}, start + 1
        found.append(value)
    # Frames fill most of the file; other objects are parts of damaged frames.
    first_key = max(size, key=size.__getitem__, default="")
    if not first_key:
        return None
    frames: list[dict] = []
    for is_frame, values in itertools.groupby(found, lambda value: next(iter(value), "") == first_key):
        if not is_frame:
            faults.add(UNREADABLE, [len(frames)], "not JSON")
        frames += values if is_frame else [{}]
    try:
        return json.loads(head[0] + "]}") | {"frames": frames} if head[1] else frames
    except ValueError:
        return None


def _text(path: Path) -> str:
    text = path.read_bytes().decode("utf-8-sig", errors="replace")
    if text.count("\ufffd") + text.count("\0") > _MAX_REPLACED * len(text):
        raise RecordingError(f"{path}: not a text file in UTF-8")
    return text


_LOADERS: dict[str, Callable[[Path, FrameFaults], Any]] = {
    ".csv": _load_table,
    ".json": _load_json,
    ".jsonl": _load_json_lines,
    **dict.fromkeys((".npy", ".npz"), lambda path, faults: load_arrays(path)),
    **dict.fromkeys((".pickle", ".pkl"), lambda path, faults: load_plain(path)),
}
