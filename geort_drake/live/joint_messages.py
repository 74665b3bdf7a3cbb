"""Joint targets for a robot's driver and joint states from it, as JSON over ZeroMQ.

Both are UTF-8 JSON of at most 64 KiB. Joint targets have exactly these fields:

    format      "geort_drake.joint_targets"
    version     1
    sequence    number of the message; grows by one
    time        when the targets were computed, s, on the sender's monotonic clock
    names       names of the joints, as in the robot's model
    position    rad, one for each name
    velocity    rad/s, one for each name: how fast the target moves
    engaged     true while the robot follows a person, false while it holds
    hold_after  s; a driver that gets no newer targets for this long holds the robot where it is

A joint state has `format` "geort_drake.joint_state", `version`, `sequence`, `time` on the driver's clock,
`names`, the measured `position` and `velocity`, and `fault`: "" or what is wrong with the robot. A driver may
report joints that the targets do not have, and targets may have joints that a driver does not move.

This module needs only NumPy, so that it also runs on a robot's computer.
"""

import dataclasses as dc
import json
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from geort_drake.errors import LiveError

VERSION, MAX_BYTES = 1, 65_536


@dc.dataclass(frozen=True, eq=False)
class JointTargets:
    """Joint targets of one moment; see the module for the fields."""

    format: ClassVar[str] = "geort_drake.joint_targets"

    sequence: int
    time: float
    names: Sequence[str]
    position: np.ndarray
    velocity: np.ndarray
    engaged: bool
    hold_after: float


@dc.dataclass(frozen=True, eq=False)
class JointState:
    """A robot's joints at one moment; see the module for the fields."""

    format: ClassVar[str] = "geort_drake.joint_state"

    sequence: int
    time: float
    names: Sequence[str]
    position: np.ndarray
    velocity: np.ndarray
    fault: str = ""


def encode(message: JointTargets | JointState) -> bytes:
    """Encodes a message.

    Raises:
        ValueError: a number is not finite.
    """
    fields = {"format": message.format, "version": VERSION} | dc.asdict(message)
    for name in ("position", "velocity"):
        fields[name] = np.asarray(fields[name], float).tolist()
    return json.dumps(fields | {"names": list(message.names)}, allow_nan=False).encode()


def decode_targets(message: bytes) -> JointTargets:
    """Decodes joint targets.

    Raises:
        LiveError: the message is malformed; the text names the field.
    """
    fields = _fields(message, JointTargets)
    if not isinstance(fields["engaged"], bool):
        raise LiveError(f"joint targets: engaged must be true or false, not {fields['engaged']!r:.40}")
    _number("joint targets", "hold_after", fields["hold_after"])
    return JointTargets(**fields)


def decode_state(message: bytes) -> JointState:
    """Decodes a joint state.

    Raises:
        LiveError: the message is malformed; the text names the field.
    """
    fields = _fields(message, JointState)
    if not isinstance(fields["fault"], str):
        raise LiveError(f"joint state: fault must be a text, not {fields['fault']!r:.40}")
    return JointState(**fields)


def _fields(message: bytes, kind: type[JointTargets] | type[JointState]) -> dict[str, Any]:
    """Returns the fields of a message, checked where both kinds agree."""
    what = kind.format.removeprefix("geort_drake.").replace("_", " ")
    if len(message) > MAX_BYTES:
        raise LiveError(f"{what}: {len(message)} bytes; at most {MAX_BYTES} are read")
    try:
        fields = json.loads(message.decode())
    except (ValueError, RecursionError) as error:
        raise LiveError(f"{what}: not JSON: {error!s:.80}") from None
    if not isinstance(fields, dict) or fields.get("format") != kind.format:
        raise LiveError(f"{what}: format must be {kind.format!r}")
    if fields.get("version") != VERSION:
        raise LiveError(f"{what}: version must be {VERSION}, not {fields.get('version')!r:.40}")
    wanted = {"format", "version", *(field.name for field in dc.fields(kind))}
    if fields.keys() != wanted:
        raise LiveError(
            f"{what}: must have the fields {', '.join(sorted(wanted))}; differs in "
            f"{', '.join(sorted(map(str, fields.keys() ^ wanted)))[:80]}"
        )
    del fields["format"], fields["version"]
    names = fields["names"]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise LiveError(f"{what}: names must be a list of texts, not {names!r:.60}")
    if len({*names}) != len(names):
        raise LiveError(f"{what}: a name occurs twice in names: {', '.join(names)[:80]}")
    for name in ("position", "velocity"):
        values = fields[name]
        if not isinstance(values, list) or len(values) != len(names):
            raise LiveError(f"{what}: {name} must be {len(names)} numbers, not {values!r:.60}")
        fields[name] = np.array([_number(what, name, value) for value in values])
    if not isinstance(fields["sequence"], int):
        raise LiveError(f"{what}: sequence must be an integer, not {fields['sequence']!r:.40}")
    _number(what, "time", fields["time"])
    return fields


def _number(what: str, name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < float("inf"):
        raise LiveError(f"{what}: {name} must be finite, not {value!r:.40}")
    return float(value)
