"""What was read from JSON, held against the type hints of a dataclass or TypedDict.

None of this package's dependencies checks types without converting, as a results file needs it: Drake's
`yaml_load_typed` takes "4" for 4.0, and NaN for a number.
"""

import dataclasses as dc
import json
import sys
import types
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints, is_typeddict

from geort_drake.errors import BenchmarkError

_WORDS = {
    bool: "true or false",
    int: "a whole number",
    float: "a finite number",
    str: "a text",
    dict: "an object",
    list: "a list",
    type(None): "null",
}


def require_type(value: Any, wanted: Any, where: str, name: str = "") -> None:
    """Checks a value of JSON; an object may have more fields than its schema.

    Args:
        value: as `json.loads` gives it.
        wanted: a type hint of dataclasses, TypedDicts, dict, list, unions, literals and what is in them.
        where: file and line, for the message.
        name: of the value within the whole, for the message.

    Raises:
        BenchmarkError: the value, or one within it, is missing or of another type, or a number is not finite;
            with `where`, the field, and what was wanted and given.
    """
    if dc.is_dataclass(wanted) or is_typeddict(wanted):
        _require(isinstance(value, dict), value, dict, where, name)
        _require_fields(value, wanted, where, f"{name}." if name else "")
    elif get_origin(wanted) is dict:
        _require(isinstance(value, dict), value, dict, where, name)
        for key, item in value.items():
            require_type(item, get_args(wanted)[1], where, f"{name}.{key}")
    elif get_origin(wanted) is list:
        _require(isinstance(value, list), value, list, where, name)
        for number, item in enumerate(value):
            require_type(item, get_args(wanted)[0], where, f"{name}[{number}]")
    else:
        _require(_fits(value, wanted), value, wanted, where, name)


def _require_fields(value: dict, schema: Any, where: str, within: str) -> None:
    hints = get_type_hints(schema)
    missing = sorted(set(getattr(schema, "__required_keys__", hints)) - value.keys())
    if missing:
        raise BenchmarkError(f"{where}: {', '.join(within + field for field in missing)} missing")
    for field, wanted in hints.items():
        if field in value:
            require_type(value[field], wanted, where, within + field)


def _require(fits: bool, value: Any, wanted: Any, where: str, name: str) -> None:
    if not fits:
        given = json.dumps(value, default=repr)
        raise BenchmarkError(f"{where}: {name or 'the whole'} must be {_described(wanted)}, not {given:.60}")


def _fits(value: Any, wanted: Any) -> bool:
    if get_origin(wanted) in (Union, types.UnionType):
        return any(_fits(value, one) for one in get_args(wanted))
    if get_origin(wanted) is Literal:
        return value in get_args(wanted)
    if wanted is Any:
        return True
    # Python counts truth values as numbers; and JSON as Python reads it has NaN, infinity and 10**400.
    if isinstance(value, bool):
        return wanted is bool
    if wanted is float:
        return isinstance(value, int | float) and abs(value) <= sys.float_info.max
    return isinstance(value, wanted)


def _described(wanted: Any) -> str:
    if get_origin(wanted) in (Union, types.UnionType):
        return " or ".join(map(_described, get_args(wanted)))
    if get_origin(wanted) is Literal:
        return " or ".join(map(json.dumps, get_args(wanted)))
    return _WORDS[wanted]
