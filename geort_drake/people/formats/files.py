"""The contents of a file by its suffix, before anything is known of its format."""

import csv
import dataclasses
import json
from pathlib import Path
from typing import Any

from geort_drake.errors import RecordingError
from geort_drake.people.formats.unpickling import load_plain
from geort_drake.people.recording import check_file, load_arrays


@dataclasses.dataclass(frozen=True)
class Table:
    """A CSV file: names of the columns, and rows of texts."""

    header: list[str]
    rows: list[list[str]]


def load(path: Path) -> Any:
    """A dict of arrays, a `Table`, or the objects of a JSON or pickle file; of a folder, its pickles.

    Raises:
        RecordingError: no such file, one too large, a suffix that is not read, or contents that do not
            fit it.
    """
    if path.is_dir():
        files = sorted(path.glob("*.pkl"))
        if not files:
            raise RecordingError(f"{path}: the folder holds no .pkl files, one per frame, as of HO-3D's meta")
        for file in files:
            check_file(file)
        return [load_plain(file) for file in files]
    check_file(path)
    suffix = path.suffix.lower()
    if suffix not in _LOADERS:
        raise RecordingError(f"{path}: recordings are read from {', '.join(_LOADERS)}, not '{path.suffix}'")
    return _LOADERS[suffix](path)


def _load_table(path: Path) -> Table:
    text = _text(path)
    first = text.partition("\n")[0]
    delimiter = max(",;\t", key=first.count)
    try:
        rows = [row for row in csv.reader(text.splitlines(), delimiter=delimiter) if any(row)]
    except csv.Error as error:
        raise RecordingError(f"{path}: not a table: {error}") from None
    if not rows:
        raise RecordingError(f"{path}: the table is empty")
    return Table([name.strip() for name in rows[0]], rows[1:])


def _load_json(path: Path) -> Any:
    try:
        return json.loads(_text(path))
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{path}: not JSON: {error}") from None


def _load_json_lines(path: Path) -> list:
    frames = []
    for number, line in enumerate(_text(path).splitlines(), 1):
        try:
            frames += [json.loads(line)] if line.strip() else []
        except (ValueError, RecursionError) as error:
            raise RecordingError(f"{path}: line {number} is not JSON: {error}") from None
    return frames


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: not a text file in UTF-8: {error}") from None


_LOADERS = {
    ".csv": _load_table,
    ".json": _load_json,
    ".jsonl": _load_json_lines,
    ".npy": load_arrays,
    ".npz": load_arrays,
    ".pickle": load_plain,
    ".pkl": load_plain,
}
