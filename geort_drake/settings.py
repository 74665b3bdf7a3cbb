"""Checks the settings in a dataclass, and parses them from NAME=VALUE texts."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import Any

from geort_drake.errors import GeortError, UnknownNameError

_BOOLEANS = {"true": True, "false": False}


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
    known = settings_of(config)
    for name in names:
        if name not in known:
            raise UnknownNameError(f"setting of {what}", name, known)


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
