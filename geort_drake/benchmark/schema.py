"""Checks of JSON against dataclasses and TypedDicts, with errors that name the field."""

import json
from pathlib import Path
from typing import Any

import msgspec

from geort_drake.errors import BenchmarkError
from geort_drake.files import finite_json


def read_json(path: Path, schema: Any, what: str) -> dict:
    """Reads a JSON file whose content has the fields of `schema`; it may have more.

    Args:
        path: of the file.
        schema: a dataclass or TypedDict.
        what: what the file should be, for the message.

    Raises:
        BenchmarkError: it is not JSON, or a field is missing, of another type or not finite.
    """
    return parse_json(path.read_bytes(), schema, f"{path}: not {what}")


def parse_json(text: bytes, schema: Any, where: str) -> dict:
    """As `read_json`, for JSON text; `where` begins the message."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BenchmarkError(f"{where}: {error}") from error
    check(content, schema, where)
    return content


def check(content: Any, schema: Any, where: str) -> None:
    """Raises BenchmarkError unless the content has the fields of `schema`, all numbers of them finite."""
    try:
        msgspec.convert(content, schema)
    except msgspec.ValidationError as error:
        raise BenchmarkError(f"{where}: {error}") from error
    for name, value in content.items():
        if finite_json(value) != value:
            raise BenchmarkError(f"{where}: {name} must be finite, not {value}")
