"""Reads a file's contents by its suffix, before its format is known."""

import csv
import json
from pathlib import Path
from typing import Any

from geort_drake.errors import RecordingError
from geort_drake.people.checks.findings import FrameFaults
from geort_drake.people.formats.source import UNREADABLE, Source, Table
from geort_drake.people.formats.unpickling import ForbiddenPickle, load_plain
from geort_drake.people.recording import check_file, load_arrays

_MOST_REPLACED = 1e-3  # share of a text's characters that are not UTF-8


def load(path: Path) -> Source:
    """A file, or a folder of pickles with one frame each. Lines or pickles that are damaged become {}.

    Raises:
        RecordingError: no such file, one too large, a suffix that is not read, or contents that do not fit
            the suffix.
    """
    faults = FrameFaults()
    if path.is_dir():
        return Source(str(path), _load_folder(path, faults), faults)
    check_file(path)
    suffix = path.suffix.lower()
    if suffix == ".jsonl":
        return Source(str(path), _load_json_lines(path, faults), faults)
    if suffix not in _LOADERS:
        suffixes = ", ".join(sorted([*_LOADERS, ".jsonl"]))
        raise RecordingError(f"{path}: recordings are read from {suffixes}, not '{path.suffix}'")
    return Source(str(path), _LOADERS[suffix](path), faults)


def _load_folder(path: Path, faults: FrameFaults) -> list:
    files = sorted(path.glob("*.pkl"))
    if not files:
        raise RecordingError(f"{path}: the folder holds no .pkl files, one per frame, as of HO-3D's meta")
    frames = []
    for i, file in enumerate(files):
        check_file(file)
        try:
            frames.append(load_plain(file))
        except RecordingError as error:
            if isinstance(error.__cause__, ForbiddenPickle):
                raise
            faults.add(UNREADABLE, [i], str(error))
            frames.append({})
    return frames


def _load_table(path: Path) -> Table:
    lines = [line for line in _text(path).splitlines() if line.strip(",;\t \0")]
    if not lines:
        raise RecordingError(f"{path}: the table is empty")
    delimiter = max(",;\t", key=lines[0].count)
    rows = []
    for line in lines:
        try:
            rows.append(next(csv.reader([line], delimiter=delimiter)))
        except csv.Error:  # of a cell too large; a row without cells is a bad frame
            rows.append([])
    return Table([name.strip() for name in rows[0]], rows[1:])


def _load_json(path: Path) -> Any:
    try:
        return json.loads(_text(path))
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{path}: not JSON: {error}") from None


def _load_json_lines(path: Path, faults: FrameFaults) -> list:
    frames: list = []
    for number, line in enumerate(_text(path).splitlines(), 1):
        if not line.strip():
            continue
        try:
            frames.append(json.loads(line))
        except (ValueError, RecursionError) as error:
            faults.add(UNREADABLE, [len(frames)], f"line {number} is not JSON: {error}")
            frames.append({})
    return frames


def _text(path: Path) -> str:
    text = path.read_bytes().decode("utf-8-sig", errors="replace")
    if text.count("\ufffd") + text.count("\0") > _MOST_REPLACED * len(text):
        raise RecordingError(f"{path}: not a text file in UTF-8")
    return text


_LOADERS = {
    ".csv": _load_table,
    ".json": _load_json,
    ".npy": load_arrays,
    ".npz": load_arrays,
    ".pickle": load_plain,
    ".pkl": load_plain,
}
