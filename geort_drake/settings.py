"""Checks settings: the numbers of a dataclass, texts NAME=VALUE, and the fields of YAML files."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import Any, get_args, get_origin, get_type_hints

import yaml

from geort_drake.errors import GeortError, UnknownNameError

_BOOLEANS = {"true": True, "false": False}
_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
_MERGE = "tag:yaml.org,2002:merge"


def parse_settings(assignments: Sequence[str], config: Any, what: str) -> dict[str, Any]:
    """Parses texts such as "steps=100" into values of the types of the fields' defaults.

    Args:
        assignments: the texts; later ones replace earlier ones of the same name.
        config: a dataclass with a default for every field, or an object of one.
        what: whose settings these are, for messages.

    Raises:
        GeortError: a text is not NAME=VALUE, or the value is not of the field's type.
        UnknownNameError: there is no such setting; the message lists the existing ones.
    """
    defaults = settings_of(config)
    settings: dict[str, Any] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise GeortError(f"a setting of {what} is given as NAME=VALUE, not as '{assignment}'")
        check_names([name], config, what)
        kind = type(defaults[name])
        try:
            settings[name] = _BOOLEANS[text.lower()] if kind is bool else kind(text)
        except (ValueError, KeyError):
            expected = "true or false" if kind is bool else kind.__name__
            raise GeortError(f"setting {name} of {what}: must be {expected}, not '{text}'") from None
    return settings


def check_names(names: Iterable[str], config: Any, what: str) -> None:
    """Raises UnknownNameError unless every name is a setting of `config`; see `settings_of`."""
    settings = settings_of(config)
    for name in names:
        if name not in settings:
            raise UnknownNameError(f"setting of {what}", name, settings)


def settings_of(config: Any) -> dict[str, Any]:
    """The fields of a dataclass that are numbers, truth values or texts, with their values."""
    values = {field.name: getattr(config, field.name, None) for field in dataclasses.fields(config)}
    return {name: value for name, value in values.items() if isinstance(value, bool | int | float | str)}


def require_numbers(config: Any, what: str, may_be_zero: bool = False) -> None:
    """Raises ValueError unless every field of a dataclass is finite and positive, or not negative."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if not (math.isfinite(value) and (value > 0 or (may_be_zero and value == 0))):
            expected = "finite and not negative" if may_be_zero else "positive and finite"
            raise ValueError(f"{what}.{field.name} must be {expected}, not {value}")


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
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
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
