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
    hold_after  s, above 0 and at most 1; a driver that gets no newer targets for this long holds the robot
                where it is

A joint state has `format` "geort_drake.joint_state", `version`, `sequence`, `time` on the driver's clock,
`names`, the measured `position` and `velocity`, and `fault`: "" or what is wrong with the robot. A driver may
report joints that the targets do not have, and targets may have joints that a driver does not move.

This module needs only NumPy, so that it also runs on a robot's computer.
"""

import dataclasses as dc
import json
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from geort_drake.errors import LiveError
from geort_drake.live.transports import MAX_BYTES, ZmqReceiver, ZmqSender, split_address

VERSION = 1
MAX_HOLD_AFTER = 1.0  # s; a robot that moves on for longer without its sender is out of control


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
    fields["hold_after"] = _number("joint targets", "hold_after", fields["hold_after"])
    if not 0.0 < fields["hold_after"] <= MAX_HOLD_AFTER:
        raise LiveError(
            f"joint targets: hold_after must be above 0 and at most {MAX_HOLD_AFTER:g} s, not "
            f"{fields['hold_after']:g}"
        )
    return JointTargets(**fields)


def decode_state(message: bytes) -> JointState:
    """Decodes a joint state.

    Raises:
        LiveError: the message is malformed; the text names the field.
    """
    fields = _fields(message, JointState)
    if not isinstance(fields["fault"], str):
        raise LiveError(f"joint state: fault must be a string, not {fields['fault']!r:.40}")
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
    if fields.get("version") != VERSION or isinstance(fields["version"], bool):
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
        raise LiveError(f"{what}: names must be a list of strings, not {names!r:.60}")
    if len({*names}) != len(names):
        raise LiveError(f"{what}: a name occurs twice in names: {', '.join(names)[:80]}")
    for name in ("position", "velocity"):
        values = fields[name]
        if not isinstance(values, list) or len(values) != len(names):
            raise LiveError(f"{what}: {name} must be {len(names)} numbers, not {values!r:.60}")
        fields[name] = np.array([_number(what, name, value) for value in values])
    if not isinstance(fields["sequence"], int) or isinstance(fields["sequence"], bool):
        raise LiveError(f"{what}: sequence must be an integer, not {fields['sequence']!r:.40}")
    fields["time"] = _number(what, "time", fields["time"])
    return fields


def _number(what: str, name: str, value: Any) -> float:
    try:
        number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    except OverflowError:  # an integer that no float can hold
        number = math.inf
    if not math.isfinite(number):
        raise LiveError(f"{what}: {name} must be finite, not {value!r:.40}")
    return number


Sent = TypeVar("Sent", JointTargets, JointState)
Received = TypeVar("Received", JointTargets, JointState)


class Bus(Generic[Sent, Received]):
    """One end of a connection between a program and a robot's driver.

    Attributes:
        refused, last_refusal: number of messages that could not be used, and why the last could not.
        arm_is_required: whether the robot always has an arm.
    """

    arm_is_required = False

    def __init__(self) -> None:
        self.refused, self.last_refusal = 0, ""

    def send(self, message: Sent) -> None:
        """Sends a message to the other end; without one, it is dropped."""
        raise NotImplementedError

    def fetch(self) -> list[Received]:
        """Returns the usable messages since the last call, oldest first; does not wait."""
        messages: list[Received] = []
        for decode, data in self._arrivals():
            try:
                messages.append(decode(data))
            except LiveError as error:
                self.refused, self.last_refusal = self.refused + 1, str(error)
        return messages

    def close(self) -> None:
        """Closes the connection."""

    def _arrivals(self) -> Iterable[tuple[Callable[[bytes], Received], bytes]]:
        """Returns the bytes of the messages since the last call, each with its decoder."""
        raise NotImplementedError


class ZmqBus(Bus[Sent, Received]):
    """JSON over a pair of ZeroMQ sockets; see `open_zmq_bus` and `open_driver_bus`."""

    def __init__(self, sender: ZmqSender, receiver: ZmqReceiver, decode: Callable[[bytes], Received]):
        super().__init__()
        self._sender, self._receiver = sender, receiver
        self._decode: Callable[[bytes], Received] = decode

    def send(self, message: Sent) -> None:
        self._sender.send(encode(message))

    def close(self) -> None:
        self._sender.close()
        self._receiver.close()

    def _arrivals(self) -> Iterable[tuple[Callable[[bytes], Received], bytes]]:
        return [(self._decode, data) for data in self._receiver.drain()]


def open_zmq_bus(endpoint: str) -> ZmqBus[JointTargets, JointState]:
    """Publishes targets at an endpoint and receives states at `status_endpoint`; both sockets listen.

    Raises:
        LiveError: an endpoint is in use, or pyzmq is not installed.
    """
    sender = ZmqSender("pub", endpoint)
    try:
        receiver = ZmqReceiver("pull", status_endpoint(endpoint), binds=True)
    except LiveError:
        sender.close()
        raise
    return ZmqBus(sender, receiver, decode_state)


def open_driver_bus(endpoint: str) -> ZmqBus[JointState, JointTargets]:
    """Connects a driver to the endpoints of `open_zmq_bus`, at once or when they are opened.

    Raises:
        LiveError: the endpoint is malformed, or pyzmq is not installed.
    """
    split_address(f"zmq+{endpoint}", ("zmq",))
    sender = ZmqSender("push", status_endpoint(endpoint), binds=False)
    return ZmqBus(sender, ZmqReceiver("sub", endpoint), decode_targets)


def status_endpoint(endpoint: str) -> str:
    """Returns the endpoint at which states are received: the next TCP port, or the path with `-state`."""
    if endpoint.startswith("tcp://"):
        host, _, port = endpoint.rpartition(":")
        return f"{host}:{int(port) + 1}"
    return f"{endpoint}-state"
