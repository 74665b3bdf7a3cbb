"""Carries joint targets to a robot and joint states back: JSON over ZeroMQ, or Drake's messages over LCM.

Addresses:
    zmq+tcp://HOST:PORT     `joint_messages`: targets are published at PORT, states come at PORT + 1
    zmq+ipc://PATH          the same, at PATH and PATH-state
    lcm, lcm+URL            an Allegro hand and a Panda arm, in Drake's `lcmt_allegro_*` and `lcmt_panda_*`
"""

import dataclasses as dc
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from drake import lcmt_allegro_command, lcmt_allegro_status, lcmt_panda_command, lcmt_panda_status
from pydrake.manipulation import PandaControlMode

from geort_drake.errors import HandError, LiveError
from geort_drake.hands.description import HandDescription
from geort_drake.live.driver import status_endpoint
from geort_drake.live.joint_messages import JointState, JointTargets, decode_state, decode_targets, encode
from geort_drake.live.transports import Inbox, ZmqReceiver, ZmqSender, open_lcm, split_address

Message = TypeVar("Message", JointState, JointTargets)
ROBOT_PATTERNS = ("zmq", "lcm")


class RobotBus(Protocol):
    """Where a robot's driver listens.

    Attributes:
        arm_is_required: whether the robot always has an arm.
    """

    arm_is_required: bool

    @property
    def refused(self) -> int:
        """Number of states that could not be used."""

    @property
    def last_refusal(self) -> str:
        """Why the last of them could not be used."""

    def send(self, targets: JointTargets) -> None:
        """Sends joint targets."""

    def fetch(self) -> list[JointState]:
        """Returns the states that have arrived since the last call, oldest first; does not wait."""

    def close(self) -> None:
        """Closes the bus."""


def open_bus(address: str, description: HandDescription) -> RobotBus:
    """Opens a robot's address.

    Raises:
        LiveError: the address is malformed or in use, or pyzmq is not installed.
        HandError: the hand has no LCM messages.
    """
    pattern, endpoint = split_address(address, ROBOT_PATTERNS)
    if pattern == "zmq":
        return ZmqBus(endpoint)
    require_lcm_messages(description)
    return LcmBus(endpoint)


def open_stand_in_bus(address: str, description: HandDescription) -> "StandInBus":
    """Opens the driver's end of a robot's address; errors as in `open_bus`."""
    pattern, endpoint = split_address(address, ROBOT_PATTERNS)
    if pattern == "zmq":
        return ZmqDriverBus(endpoint)
    require_lcm_messages(description)
    return LcmDriverBus(endpoint)


class StandInBus(Protocol):
    """The driver's end of a bus."""

    def send(self, state: JointState) -> None:
        """Sends a joint state."""

    def fetch(self) -> list[JointTargets]:
        """Returns the targets that have arrived since the last call, oldest first; does not wait."""


class _Zmq(Generic[Message]):
    """Sends and receives JSON over two ZeroMQ sockets."""

    arm_is_required = False

    def __init__(self, sender: ZmqSender, receiver: ZmqReceiver, decode: Callable[[bytes], Message]):
        self._sender, self._receiver = sender, receiver
        self._decode: Callable[[bytes], Message] = decode
        self.refused, self.last_refusal = 0, ""

    def send(self, message: JointState | JointTargets) -> None:
        self._sender.send(encode(message))

    def fetch(self) -> list[Message]:
        messages: list[Message] = []
        for data in self._receiver.drain():
            try:
                messages.append(self._decode(data))
            except LiveError as error:
                self.refused, self.last_refusal = self.refused + 1, str(error)
        return messages

    def close(self) -> None:
        self._sender.close()
        self._receiver.close()


class ZmqBus(_Zmq[JointState]):
    """Publishes targets at an endpoint and receives states at the next; both sockets listen."""

    def __init__(self, endpoint: str):
        sender = ZmqSender("pub", endpoint)
        try:
            receiver = ZmqReceiver("pull", status_endpoint(endpoint), binds=True)
        except LiveError:
            sender.close()
            raise
        super().__init__(sender, receiver, decode_state)


class ZmqDriverBus(_Zmq[JointTargets]):
    """The driver's end of `ZmqBus`, which connects."""

    def __init__(self, endpoint: str):
        sender = ZmqSender("push", status_endpoint(endpoint), binds=False)
        super().__init__(sender, ZmqReceiver("sub", endpoint), decode_targets)


@dc.dataclass(frozen=True)
class Device:
    """A hand or an arm on LCM that takes position commands.

    Attributes:
        name: name in error messages.
        joints: names of the joints, in the order of the messages.
        channel: prefix of its LCM channels, `channel`_COMMAND and `channel`_STATUS.
        command_type, status_type: Drake's message classes.
        count_field: field of a command with the number of positions; its positions are in `joint_position`.
        status_fields: fields of a status with positions, velocities and commanded positions.
        constants: other fields of both and their values; a received command must have these values.
    """

    name: str
    joints: tuple[str, ...]
    channel: str
    command_type: type
    status_type: type
    count_field: str
    status_fields: tuple[str, str, str]
    constants: Mapping[str, float] = dc.field(default_factory=dict)

    def encode_command(self, time: float, position: Sequence[float]) -> bytes:
        """Returns the message that commands positions (n,), rad, at `time`, s."""
        fields = {self.count_field: len(position), "joint_position": list(position)}
        return self._encode(self.command_type, time, fields)

    def decode_command(self, message: bytes) -> JointTargets:
        """Returns the commanded positions as targets that do not move.

        Raises:
            LiveError: the message is malformed, for another number of joints, or not finite.
        """
        size = len(self.encode_command(0.0, [0.0] * len(self.joints)))
        command = self._decode(self.command_type, message, size)
        for field, expected in self.constants.items():
            if (given := getattr(command, field, expected)) != expected:
                raise LiveError(f"{self.name}: {field} must be {expected}, not {given}")
        q = self._joint_values(command, "joint_position")
        return JointTargets(0, 1e-6 * command.utime, self.joints, q, np.zeros_like(q), True, np.inf)

    def encode_status(self, time: float, position: Sequence[float], velocity: Sequence[float]) -> bytes:
        """Returns the status message at `time`, s. Fields that are not simulated are zero."""
        n = len(position)
        # Each list in a status has one number per joint.
        empty = self.status_type()
        fields = {name: [0.0] * n for name in empty.__slots__ if isinstance(getattr(empty, name), list)}
        measured = zip(self.status_fields, (position, velocity, position), strict=True)
        return self._encode(
            self.status_type, time, {"num_joints": n} | fields | {name: list(part) for name, part in measured}
        )

    def decode_status(self, message: bytes) -> JointState:
        """Returns the state in a status.

        Raises:
            LiveError: the message is malformed, of another number of joints, or not finite.
        """
        zeros = [0.0] * len(self.joints)
        status = self._decode(self.status_type, message, len(self.encode_status(0.0, zeros, zeros)))
        q, v, _ = (self._joint_values(status, field) for field in self.status_fields)
        return JointState(0, 1e-6 * status.utime, self.joints, q, v)

    def _encode(self, kind: type, time: float, fields: Mapping[str, Any]) -> bytes:
        message: Any = kind()
        message.utime = round(1e6 * time)
        for name, value in {**self.constants, **fields}.items():
            if name in message.__slots__:
                setattr(message, name, value)
        return message.encode()

    def _decode(self, kind: type, message: bytes, size: int) -> Any:
        # Checks the size first, because the decoder allocates whatever the message asks for.
        if len(message) != size:
            raise LiveError(
                f"{self.name}: {kind.__name__} of {len(message)} bytes; one for {len(self.joints)} joints "
                f"has {size}. Is this the hand that the robot has?"
            )
        try:
            return kind.decode(message)  # type: ignore[attr-defined]
        except (ValueError, struct.error) as error:
            raise LiveError(f"{self.name}: {kind.__name__} cannot be decoded: {error}") from None

    def _joint_values(self, message: Any, field: str) -> np.ndarray:
        values = np.array(getattr(message, field), float)
        if values.shape != (len(self.joints),) or not np.isfinite(values).all():
            raise LiveError(
                f"{self.name}: {field} must be {len(self.joints)} finite numbers, not {values.tolist()!s:.80}"
            )
        return values


ALLEGRO = Device(
    name="Allegro hand",
    joints=tuple(f"joint_{i}" for i in range(16)),
    channel="ALLEGRO",
    command_type=lcmt_allegro_command,
    status_type=lcmt_allegro_status,
    count_field="num_joints",
    status_fields=("joint_position_measured", "joint_velocity_estimated", "joint_position_commanded"),
)
PANDA = Device(
    name="Panda arm",
    joints=tuple(f"panda_joint{i}" for i in range(1, 8)),
    channel="PANDA",
    command_type=lcmt_panda_command,
    status_type=lcmt_panda_status,
    count_field="num_joint_position",
    status_fields=("joint_position", "joint_velocity", "joint_position_desired"),
    constants={
        "control_mode_expected": PandaControlMode.kPosition,
        "control_mode": PandaControlMode.kPosition,
        "control_command_success_rate": 1.0,
    },
)
DEVICES = (ALLEGRO, PANDA)


def require_lcm_messages(description: HandDescription) -> None:
    """Checks that Drake has messages for a hand, by its name: LEAP's joints are named like the Allegro's.

    Raises:
        HandError: the hand is not an Allegro hand.
    """
    if not description.name.startswith("allegro"):
        raise HandError(
            f"hand '{description.name}' has no LCM messages; only hands whose name begins with allegro have: "
            "lcmt_allegro_command and lcmt_allegro_status. Every hand can be driven over ZeroMQ: "
            "zmq+tcp://127.0.0.1:5557"
        )


class _Lcm(Generic[Message]):
    """Sends and receives Drake's messages of all devices on an LCM bus."""

    arm_is_required = True

    def __init__(self, url: str, decoders: Mapping[str, Callable[[bytes], Message]]):
        """Takes LCM channel → decoder of its messages."""
        self._lcm = open_lcm(url)
        self._inbox = Inbox(self._lcm, decoders)

    @property
    def refused(self) -> int:
        return self._inbox.refused

    @property
    def last_refusal(self) -> str:
        return self._inbox.last_refusal

    def fetch(self) -> list[Message]:
        return self._inbox.fetch()

    def close(self) -> None:
        pass


class LcmBus(_Lcm[JointState]):
    """Commands an Allegro hand and a Panda arm, and receives their statuses."""

    def __init__(self, url: str):
        super().__init__(url, {f"{d.channel}_STATUS": d.decode_status for d in DEVICES})

    def send(self, targets: JointTargets) -> None:
        q = dict(zip(targets.names, targets.position, strict=True))
        for device in DEVICES:
            message = device.encode_command(targets.time, [float(q[name]) for name in device.joints])
            self._lcm.Publish(f"{device.channel}_COMMAND", message)


class LcmDriverBus(_Lcm[JointTargets]):
    """The driver's end of `LcmBus`."""

    def __init__(self, url: str):
        super().__init__(url, {f"{d.channel}_COMMAND": d.decode_command for d in DEVICES})

    def send(self, state: JointState) -> None:
        values = {
            name: (q, v) for name, q, v in zip(state.names, state.position, state.velocity, strict=True)
        }
        for device in DEVICES:
            position, velocity = zip(*(values[name] for name in device.joints), strict=True)
            self._lcm.Publish(
                f"{device.channel}_STATUS", device.encode_status(state.time, position, velocity)
            )
