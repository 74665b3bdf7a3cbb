"""Robot hands and arms on LCM: their joints, Drake's messages for them, and their newest messages.

Drake defines the message types in its folder `lcmtypes/`.
"""

import dataclasses as dc
import struct
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from drake import lcmt_allegro_command, lcmt_allegro_status, lcmt_panda_command, lcmt_panda_status
from pydrake.lcm import DrakeLcm
from pydrake.manipulation import PandaControlMode

from geort_drake.errors import HandError, LiveError
from geort_drake.hands.description import HandDescription
from geort_drake.simulation.following import JointGroup


@dc.dataclass(frozen=True)
class JointStatus:
    """State of a device's n joints: positions, rad, velocities, rad/s, and commanded positions, rad; (n,)."""

    position: np.ndarray
    velocity: np.ndarray
    commanded: np.ndarray


@dc.dataclass(frozen=True)
class Device:
    """A hand or an arm of n joints that takes position commands and reports its state.

    Attributes:
        name: name in error messages.
        joints: names of the joints, in the order of the messages.
        command_channel, status_channel: LCM channels.
        command_type, status_type: Drake's message classes.
        count_field: field of a command with the number of positions; its positions are in `joint_position`.
        status_fields: fields of a status with positions, velocities and commanded positions.
        command_constants, status_constants: other fields and their values; a received command must have
            these values.
    """

    name: str
    joints: tuple[str, ...]
    command_channel: str
    status_channel: str
    command_type: type
    status_type: type
    count_field: str
    status_fields: tuple[str, str, str]
    command_constants: Mapping[str, float] = dc.field(default_factory=dict)
    status_constants: Mapping[str, float] = dc.field(default_factory=dict)

    def encode_command(self, time: float, position: np.ndarray) -> bytes:
        """Returns the message that commands positions (n,), rad, at `time`, s."""
        fields = {self.count_field: len(position), "joint_position": position.tolist()}
        return self._encode(self.command_type, time, fields | dict(self.command_constants))

    def decode_command(self, message: bytes) -> np.ndarray:
        """Returns the commanded positions (n,), rad.

        Raises:
            LiveError: the message is malformed, for another number of joints, or not finite.
        """
        zeros = np.zeros(len(self.joints))
        command = self._decode(self.command_type, message, len(self.encode_command(0.0, zeros)))
        for field, expected in self.command_constants.items():
            if (given := getattr(command, field)) != expected:
                raise LiveError(f"{self.name}: {field} must be {expected}, not {given}")
        return self._joint_values(command, "joint_position")

    def encode_status(self, time: float, status: JointStatus) -> bytes:
        """Returns the status message at `time`, s. Fields that are not simulated are zero."""
        n = len(status.position)
        # Each list in a status has one number per joint.
        empty = self.status_type()
        zeros = {name: [0.0] * n for name in empty.__slots__ if isinstance(getattr(empty, name), list)}
        parts = (status.position, status.velocity, status.commanded)
        values = {field: part.tolist() for field, part in zip(self.status_fields, parts, strict=True)}
        return self._encode(
            self.status_type, time, {"num_joints": n} | zeros | values | dict(self.status_constants)
        )

    def decode_status(self, message: bytes) -> JointStatus:
        """Returns the status in a message.

        Raises:
            LiveError: the message is malformed, of another number of joints, or not finite.
        """
        zeros = np.zeros(len(self.joints))
        size = len(self.encode_status(0.0, JointStatus(zeros, zeros, zeros)))
        status = self._decode(self.status_type, message, size)
        return JointStatus(*(self._joint_values(status, field) for field in self.status_fields))

    def model_order(self, group: JointGroup) -> np.ndarray:
        """Returns the indices that put values in the messages' order into the model's.

        Raises:
            HandError: the model has other joints.
        """
        if set(group.joints) != set(self.joints):
            raise HandError(
                f"{self.name}: its LCM messages are for {', '.join(self.joints)}; "
                f"the model's {group.name} has {', '.join(group.joints)}"
            )
        return np.array([self.joints.index(name) for name in group.joints])

    def _encode(self, kind: type, time: float, fields: Mapping[str, Any]) -> bytes:
        message: Any = kind()
        message.utime = round(1e6 * time)
        for name, value in fields.items():
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
    command_channel="ALLEGRO_COMMAND",
    status_channel="ALLEGRO_STATUS",
    command_type=lcmt_allegro_command,
    status_type=lcmt_allegro_status,
    count_field="num_joints",
    status_fields=("joint_position_measured", "joint_velocity_estimated", "joint_position_commanded"),
)
PANDA = Device(
    name="Panda arm",
    joints=tuple(f"panda_joint{i}" for i in range(1, 8)),
    command_channel="PANDA_COMMAND",
    status_channel="PANDA_STATUS",
    command_type=lcmt_panda_command,
    status_type=lcmt_panda_status,
    count_field="num_joint_position",
    status_fields=("joint_position", "joint_velocity", "joint_position_desired"),
    command_constants={"control_mode_expected": PandaControlMode.kPosition},
    status_constants={"control_mode": PandaControlMode.kPosition, "control_command_success_rate": 1.0},
)


def require_hand_messages(description: HandDescription) -> None:
    """Checks that Drake has messages for a hand, by its name: LEAP's joints are named like the Allegro's.

    Raises:
        HandError: the hand is not an Allegro hand.
    """
    if not description.name.startswith("allegro"):
        raise HandError(
            f"hand '{description.name}' has no LCM messages; only hands whose name begins with allegro have: "
            "lcmt_allegro_command and lcmt_allegro_status"
        )


class LcmInbox:
    """Keeps the newest usable message of each of several LCM channels.

    Attributes:
        newest: channel → decoded contents of its newest usable message.
        arrived: channel → when that message arrived, s.
        refused: number of messages that could not be used.
        last_refusal: why the last of them could not be used.

    Args:
        lcm: the bus.
        decoders: channel → function that decodes its messages or raises LiveError.
        clock: monotonic clock, s.
    """

    def __init__(
        self,
        lcm: DrakeLcm,
        decoders: Mapping[str, Callable[[bytes], Any]],
        clock: Callable[[], float] = time.monotonic,
    ):
        self._lcm, self._clock = lcm, clock
        self.newest: dict[str, Any] = {}
        self.arrived: dict[str, float] = {}
        self.refused = 0
        self.last_refusal = ""
        for channel, decode in decoders.items():
            lcm.Subscribe(channel, lambda message, c=channel, d=decode: self._keep(c, d, message))

    def fetch(self) -> None:
        """Reads the messages that have arrived. LCM keeps only one per channel, so call this often."""
        self._lcm.HandleSubscriptions(0)

    def _keep(self, channel: str, decode: Callable[[bytes], Any], message: bytes) -> None:
        try:
            self.newest[channel] = decode(message)
            self.arrived[channel] = self._clock()
        except LiveError as error:
            self.refused += 1
            self.last_refusal = str(error)
