"""Describes faults of YAML files: the field, what was expected and what was given."""

import dataclasses as dc
from typing import Any, get_args, get_origin, get_type_hints

import yaml

_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
_MERGE = "tag:yaml.org,2002:merge"


def fault_of(error: Exception) -> str:
    """Describes a YAML loader's exception in one line; syntax errors with line and column."""
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        mark = error.problem_mark
        return f"line {mark.line + 1}, column {mark.column + 1}: {error.problem}"
    return " ".join(str(error).split())


def check_fields(node: yaml.Node | None, schema: type, name: str = "") -> None:
    """Checks the names of a mapping's fields and the types of numbers, also in nested dataclasses and lists.

    Args:
        node: the parsed YAML; None for an empty document.
        schema: the dataclass to which it is converted.
        name: name of the mapping in messages; empty for the whole document.

    Raises:
        ValueError: names the field, what was expected and what was given.
    """
    hints = get_type_hints(schema)
    choices = ", ".join(sorted(hints))
    if not isinstance(node, yaml.MappingNode):
        what = f"field {name}" if name else "it"
        text = "nothing" if node is None else _text_of(node)
        raise ValueError(f"{what} must be a mapping with some of: {choices}; given: {text}")
    for key, value in node.value:
        field = f"{name}.{key.value}".removeprefix(".")
        if key.value in hints:
            _check_value(value, hints[key.value], field)
        elif key.tag != _MERGE:
            raise ValueError(f"unknown field '{field}'; choose one of: {choices}")


def _check_value(node: yaml.Node, kind: Any, name: str) -> None:
    if dc.is_dataclass(kind) and isinstance(kind, type):
        check_fields(node, kind, name)
    elif get_origin(kind) is list and isinstance(node, yaml.SequenceNode):
        for number, entry in enumerate(node.value):
            _check_value(entry, get_args(kind)[0], f"{name}.{number}")
    elif kind in (int, float) and node.tag not in _NUMBERS:
        try:
            float(node.value)
        except (TypeError, ValueError):
            raise ValueError(f"field {name} must be a number; given: {_text_of(node)}") from None


def _text_of(node: yaml.Node) -> str:
    return f"'{node.value}'" if isinstance(node, yaml.ScalarNode) else f"a {node.id}"
