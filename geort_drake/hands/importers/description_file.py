"""Writes a hand description as YAML that a person can read and correct."""

import dataclasses as dc
import os
from collections.abc import Iterable
from pathlib import Path

import yaml

from geort_drake.files import write_text
from geort_drake.hands.description import HandDescription


def write_description(description: HandDescription, path: Path, comments: Iterable[str] = ()) -> None:
    """Writes a description atomically; fields with their default values are left out.

    A model below the description's folder is named relative to it.

    Args:
        comments: lines to put before it.
    """
    facts = _without_defaults(description)
    model = Path(description.model)
    folder = path.resolve().parent
    if model.is_absolute() and model.is_relative_to(folder):
        facts["model"] = os.path.relpath(model, folder)
    head = "".join(f"# {line}\n" for line in comments)
    # Short lists and mappings stay on one line.
    text = yaml.safe_dump(facts, sort_keys=False, default_flow_style=None, allow_unicode=True, width=110)
    write_text(path, head + text)


def _without_defaults(value: object) -> dict:
    """A dataclass as a mapping of the fields that differ from its defaults."""
    kept = {}
    for field in dc.fields(value):  # type: ignore[arg-type]
        given = getattr(value, field.name)
        if given == getattr(type(value)(), field.name):
            continue
        if dc.is_dataclass(given):
            given = _without_defaults(given)
        elif isinstance(given, list) and given and dc.is_dataclass(given[0]):
            given = [_without_defaults(item) for item in given]
        kept[field.name] = given
    return kept
