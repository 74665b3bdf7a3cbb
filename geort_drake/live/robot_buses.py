"""Carries joint targets to a robot and joint states back: JSON over ZeroMQ, or Drake's messages over LCM.

Addresses:
    zmq+tcp://HOST:PORT     `joint_messages`: targets are published at PORT, states come at PORT + 1
    zmq+ipc://PATH          the same, at PATH and PATH-state
    lcm, lcm+URL            an Allegro hand and a Panda arm, in Drake's `lcmt_allegro_*` and `lcmt_panda_*`
"""

import dataclasses as dc
import functools
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from drake import lcmt_allegro_command, lcmt_allegro_status, lcmt_panda_command, lcmt_panda_status
from pydrake.lcm import DrakeLcm
from pydrake.manipulation import PandaControlMode

from geort_drake.errors import HandError, LiveError
from geort_drake.hands.description import HandDescription
from geort_drake.live.joint_messages import (
    Bus,
    JointState,
    JointTargets,
    Received,
    Sent,
    open_driver_bus,
    open_zmq_bus,
)
from geort_drake.live.transports import check_lcm_url, split_address


def open_bus(address: str, description: HandDescription, driver: bool = False) -> Bus:
    """Opens a robot's address, or with `driver` the driver's end of it.

    Raises:
        LiveError: the address is malformed or in use, or pyzmq is not installed.
        HandError: the hand has no LCM messages.
    """
    pattern, endpoint = split_address(address, ("zmq", "lcm"))
    if pattern == "zmq":
        return open_driver_bus(endpoint) if driver else open_zmq_bus(endpoint)
    require_lcm_messages(description)
    if driver:
        return LcmBus(endpoint, ("STATUS", LcmDevice.encode_status), ("COMMAND", LcmDevice.decode_command))
    return LcmBus(endpoint, ("COMMAND", LcmDevice.encode_command), ("STATUS", LcmDevice.decode_status))


@dc.dataclass(frozen=True)
class LcmDevice:
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

    def encode_command(self, targets: JointTargets) -> bytes:
        """Returns the message that commands the targets' positions of the device's joints."""
        (q,) = self._in_order(targets.names, targets.position)
        return self._encode(self.command_type, targets.time, {self.count_field: len(q), "joint_position": q})

    def decode_command(self, message: bytes) -> JointTargets:
        """Returns the commanded positions as targets that do not move.

        Raises:
            LiveError: the message is malformed, for another number of joints, or not finite.
        """
        zeros = np.zeros(len(self.joints))
        size = len(self.encode_command(JointTargets(0, 0.0, self.joints, zeros, zeros, True, np.inf)))
        command = self._decode(self.command_type, message, size)
        for field, expected in self.constants.items():
            if (value := getattr(command, field, expected)) != expected:
                raise LiveError(f"{self.name}: {field} must be {expected}, not {value}")
        q = self._joint_values(command, "joint_position")
        return JointTargets(0, 1e-6 * command.utime, self.joints, q, zeros, True, np.inf)

    def encode_status(self, state: JointState) -> bytes:
        """Returns the status of the device's joints. Fields that are not simulated are zero."""
        n = len(self.joints)
        # Each list in a status has one number per joint.
        empty = self.status_type()
        fields = {name: [0.0] * n for name in empty.__slots__ if isinstance(getattr(empty, name), list)}
        q, v = self._in_order(state.names, state.position, state.velocity)
        fields |= zip(self.status_fields, (q, v, q), strict=True)
        return self._encode(self.status_type, state.time, {"num_joints": n} | fields)

    def decode_status(self, message: bytes) -> JointState:
        """Returns the state in a status.

        Raises:
            LiveError: the message is malformed, of another number of joints, or not finite.
        """
        zeros = np.zeros(len(self.joints))
        size = len(self.encode_status(JointState(0, 0.0, self.joints, zeros, zeros)))
        status = self._decode(self.status_type, message, size)
        q, v, _ = (self._joint_values(status, field) for field in self.status_fields)
        return JointState(0, 1e-6 * status.utime, self.joints, q, v)

    def _in_order(self, names: Sequence[str], *values: np.ndarray) -> list[list[float]]:
        """Returns arrays of values (N,) of named joints as lists for the device's joints, in its order."""
        order = [list(names).index(name) for name in self.joints]
        return [np.asarray(array, float)[order].tolist() for array in values]

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


ALLEGRO = LcmDevice(
    name="Allegro hand",
    joints=tuple(f"joint_{i}" for i in range(16)),
    channel="ALLEGRO",
    command_type=lcmt_allegro_command,
    status_type=lcmt_allegro_status,
    count_field="num_joints",
    status_fields=("joint_position_measured", "joint_velocity_estimated", "joint_position_commanded"),
)
PANDA = LcmDevice(
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


class LcmBus(Bus[Sent, Received]):
    """Drake's messages for all devices on an LCM bus.

    Args:
        url: LCM URL.
        sends: ending of the channels to which it sends, and the method that encodes for a device.
        receives: ending of the channels that it receives, and the method that decodes a device's messages.

    Raises:
        LiveError: the URL is malformed.
    """

    arm_is_required = True

    def __init__(
        self,
        url: str,
        sends: tuple[str, Callable[[LcmDevice, Sent], bytes]],
        receives: tuple[str, Callable[[LcmDevice, bytes], Received]],
    ):
        super().__init__()
        check_lcm_url(url)
        self._lcm = DrakeLcm(url)
        self._ending: str = sends[0]
        self._encode: Callable[[LcmDevice, Sent], bytes] = sends[1]
        self._new: list[tuple[Callable[[bytes], Received], bytes]] = []
        ending, decode = receives
        for device in DEVICES:
            decoder: Callable[[bytes], Received] = functools.partial(decode, device)
            self._lcm.Subscribe(
                f"{device.channel}_{ending}",
                lambda message, decoder=decoder: self._new.append((decoder, message)),
            )

    def send(self, message: Sent) -> None:
        for device in DEVICES:
            self._lcm.Publish(f"{device.channel}_{self._ending}", self._encode(device, message))

    def _arrivals(self) -> Iterable[tuple[Callable[[bytes], Received], bytes]]:
        # LCM keeps only one message per channel, so this must be called often.
        self._lcm.HandleSubscriptions(0)
        new, self._new = self._new, []
        return new
