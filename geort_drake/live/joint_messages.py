"""Joint targets for a robot's driver and joint states from it, as JSON over ZeroMQ.

Both are UTF-8 JSON of at most 64 KiB. Joint targets have these fields and no others, of which the first
two may be left out:

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

This module needs no Drake, so that it also runs on a robot's computer.
"""

from collections.abc import Callable, Iterable
from typing import Annotated, Generic, Literal, TypeVar

import msgspec

from geort_drake.errors import LiveError
from geort_drake.live.transports import ZmqSocket, decode_json, split_address

MAX_HOLD_AFTER = 1.0  # s; a robot that moves on for longer without its sender is out of control


class _Version(msgspec.Struct, frozen=True, kw_only=True):
    version: Literal[1] = 1


class _Joints(_Version, frozen=True, forbid_unknown_fields=True, tag_field="format"):
    sequence: int
    time: float
    names: list[str]
    position: list[float]
    velocity: list[float]

    def __post_init__(self) -> None:
        for name, values in (("position", self.position), ("velocity", self.velocity)):
            if len(values) != len(self.names):
                raise ValueError(f"{name} must be {len(self.names)} numbers, one for each name")
        if len({*self.names}) != len(self.names):
            raise ValueError(f"a name occurs twice in names: {', '.join(self.names)[:80]}")


class JointTargets(_Joints, frozen=True, tag="geort_drake.joint_targets"):
    """Joint targets of one moment; see the module for the fields."""

    engaged: bool
    hold_after: Annotated[float, msgspec.Meta(gt=0.0, le=MAX_HOLD_AFTER)]


class JointState(_Joints, frozen=True, tag="geort_drake.joint_state"):
    """A robot's joints at one moment; see the module for the fields."""

    fault: str = ""


_TARGETS, _STATE = msgspec.json.Decoder(JointTargets), msgspec.json.Decoder(JointState)
encode = msgspec.json.encode


def decode_targets(message: bytes) -> JointTargets:
    """Decodes joint targets; a LiveError names the field that is malformed."""
    return decode_json(_TARGETS, message, "joint targets")


def decode_state(message: bytes) -> JointState:
    """Decodes a joint state; a LiveError names the field that is malformed."""
    return decode_json(_STATE, message, "joint state")


Outgoing = TypeVar("Outgoing", JointTargets, JointState)
Incoming = TypeVar("Incoming", JointTargets, JointState)


class Bus(Generic[Outgoing, Incoming]):
    """One end of a connection between a program and a robot's driver.

    Attributes:
        refused, last_refusal: number of messages that could not be used, and why the last could not.
        arm_is_required: whether the robot always has an arm.
    """

    arm_is_required = False

    def __init__(self) -> None:
        self.refused, self.last_refusal = 0, ""

    def send(self, message: Outgoing) -> None:
        """Sends a message to the other end; without one, it is dropped."""
        raise NotImplementedError

    def fetch(self) -> list[Incoming]:
        """Returns the usable messages since the last call, oldest first; does not wait."""
        messages: list[Incoming] = []
        for decode, data in self._arrivals():
            try:
                messages.append(decode(data))
            except LiveError as error:
                self.refused, self.last_refusal = self.refused + 1, str(error)
        return messages

    def close(self) -> None:
        """Closes the connection."""

    def _arrivals(self) -> Iterable[tuple[Callable[[bytes], Incoming], bytes]]:
        """Returns the bytes of the messages since the last call, each with its decoder."""
        raise NotImplementedError


class ZmqBus(Bus[Outgoing, Incoming]):
    """JSON over a pair of ZeroMQ sockets; see `open_zmq_bus` and `open_driver_bus`."""

    def __init__(self, sender: ZmqSocket, receiver: ZmqSocket, decode: Callable[[bytes], Incoming]):
        super().__init__()
        self._sender, self._receiver = sender, receiver
        self._decode: Callable[[bytes], Incoming] = decode

    def send(self, message: Outgoing) -> None:
        self._sender.send(encode(message))

    def close(self) -> None:
        self._sender.close()
        self._receiver.close()

    def _arrivals(self) -> Iterable[tuple[Callable[[bytes], Incoming], bytes]]:
        return [(self._decode, data) for data in self._receiver.drain()]


def open_zmq_bus(endpoint: str) -> ZmqBus[JointTargets, JointState]:
    """Publishes targets at an endpoint and receives states at `status_endpoint`; both sockets listen.

    Raises:
        LiveError: an endpoint is in use.
    """
    sender = ZmqSocket("pub", endpoint, binds=True)
    try:
        receiver = ZmqSocket("pull", status_endpoint(endpoint), binds=True)
    except LiveError:
        sender.close()
        raise
    return ZmqBus(sender, receiver, decode_state)


def open_driver_bus(endpoint: str) -> ZmqBus[JointState, JointTargets]:
    """Connects a driver to the endpoints of `open_zmq_bus`, at once or when they are opened.

    Raises:
        LiveError: the endpoint is malformed.
    """
    split_address(f"zmq+{endpoint}", ("zmq",))
    sender = ZmqSocket("push", status_endpoint(endpoint), binds=False)
    return ZmqBus(sender, ZmqSocket("sub", endpoint, binds=False), decode_targets)


def status_endpoint(endpoint: str) -> str:
    """Returns the endpoint at which states are received: the next TCP port, or the path with `-state`."""
    if endpoint.startswith("tcp://"):
        host, _, port = endpoint.rpartition(":")
        return f"{host}:{int(port) + 1}"
    return f"{endpoint}-state"
