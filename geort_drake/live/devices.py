"""A robot's devices on LCM: their joints, and what Drake's messages say of them.

The message types are Drake's, in `lcmtypes/` of its sources. A message that is not exactly as long as one of
the device's joints has to be is refused before it is decoded.
"""

import abc
import dataclasses as dc
import struct
from typing import Any

import numpy as np
from drake import lcmt_allegro_command, lcmt_allegro_status, lcmt_panda_command, lcmt_panda_status
from pydrake.manipulation import PandaControlMode

from geort_drake.errors import HandError, LiveError
from geort_drake.hands.description import HandDescription
from geort_drake.live.joint_group import JointGroup


@dc.dataclass(frozen=True)
class JointStatus:
    """What a device says of its n joints: (n,) rad, rad/s, and the command it follows, rad."""

    position: np.ndarray
    velocity: np.ndarray
    commanded: np.ndarray


class Device(abc.ABC):
    """n joints that are commanded positions and tell their state.

    Attributes:
        name: for messages to people.
        joints: by name, in the order of the messages.
        command_channel, status_channel: of the LCM bus.
    """

    name: str
    joints: tuple[str, ...]
    command_channel: str
    status_channel: str

    @abc.abstractmethod
    def encode_command(self, time: float, position: np.ndarray) -> bytes:
        """The command of positions (n,), rad, at a time, s."""

    @abc.abstractmethod
    def encode_status(self, time: float, status: JointStatus) -> bytes:
        """The status message of a time, s."""

    @abc.abstractmethod
    def decode_command(self, message: bytes) -> np.ndarray:
        """The positions (n,), rad, of a command.

        Raises:
            LiveError: the message is malformed, not for so many joints, or not finite.
        """

    @abc.abstractmethod
    def decode_status(self, message: bytes) -> JointStatus:
        """The status in a message.

        Raises:
            LiveError: as `decode_command`.
        """

    def require_joints(self, group: JointGroup) -> None:
        """Raises HandError unless a model has this device's joints, whatever their order."""
        if set(group.joints) != set(self.joints):
            raise HandError(
                f"{self.name}: its LCM messages are of {', '.join(self.joints)}; the model's "
                f"{group.name} has {', '.join(group.joints)}"
            )

    def _decode(self, kind: type, message: bytes, size: int) -> Any:
        what = f"{self.name}: {kind.__name__}"
        if len(message) != size:
            raise LiveError(
                f"{what} of {len(message)} bytes; one of {len(self.joints)} joints has {size}. "
                "Is this the hand that the robot has?"
            )
        try:
            return kind.decode(message)  # type: ignore[attr-defined]
        except (ValueError, struct.error) as error:
            raise LiveError(f"{what} cannot be decoded: {error}") from None

    def _array(self, values: Any, field: str) -> np.ndarray:
        array = np.array(values, float)
        if array.shape != (len(self.joints),) or not np.isfinite(array).all():
            raise LiveError(
                f"{self.name}: {field} must be {len(self.joints)} finite numbers, not {values!s:.80}"
            )
        return array

    def _status(self, message: Any, position: str, velocity: str, commanded: str) -> JointStatus:
        return JointStatus(*(self._array(getattr(message, f), f) for f in (position, velocity, commanded)))


class _Allegro(Device):
    name = "Allegro hand"
    joints = tuple(f"joint_{i}" for i in range(16))
    command_channel, status_channel = "ALLEGRO_COMMAND", "ALLEGRO_STATUS"

    def encode_command(self, time: float, position: np.ndarray) -> bytes:
        message = lcmt_allegro_command()
        message.utime = round(1e6 * time)
        message.num_joints, message.joint_position = len(position), position.tolist()
        return message.encode()

    def decode_command(self, message: bytes) -> np.ndarray:
        size = len(self.encode_command(0.0, np.zeros(len(self.joints))))
        return self._array(self._decode(lcmt_allegro_command, message, size).joint_position, "joint_position")

    def encode_status(self, time: float, status: JointStatus) -> bytes:
        message = lcmt_allegro_status()
        message.utime, message.num_joints = round(1e6 * time), len(status.position)
        message.joint_position_measured = status.position.tolist()
        message.joint_velocity_estimated = status.velocity.tolist()
        message.joint_position_commanded = status.commanded.tolist()
        message.joint_torque_commanded = [0.0] * len(status.position)
        return message.encode()

    def decode_status(self, message: bytes) -> JointStatus:
        zeros = np.zeros(len(self.joints))
        size = len(self.encode_status(0.0, JointStatus(zeros, zeros, zeros)))
        return self._status(
            self._decode(lcmt_allegro_status, message, size),
            "joint_position_measured",
            "joint_velocity_estimated",
            "joint_position_commanded",
        )


class _Panda(Device):
    name = "Panda arm"
    joints = tuple(f"panda_joint{i}" for i in range(1, 8))
    command_channel, status_channel = "PANDA_COMMAND", "PANDA_STATUS"

    def encode_command(self, time: float, position: np.ndarray) -> bytes:
        message = lcmt_panda_command()
        message.utime = round(1e6 * time)
        message.num_joint_position, message.joint_position = len(position), position.tolist()
        message.control_mode_expected = PandaControlMode.kPosition
        return message.encode()

    def decode_command(self, message: bytes) -> np.ndarray:
        size = len(self.encode_command(0.0, np.zeros(len(self.joints))))
        command = self._decode(lcmt_panda_command, message, size)
        if command.control_mode_expected != PandaControlMode.kPosition:
            raise LiveError(
                f"{self.name}: control_mode_expected must be {PandaControlMode.kPosition} (position), not "
                f"{command.control_mode_expected}"
            )
        return self._array(command.joint_position, "joint_position")

    def encode_status(self, time: float, status: JointStatus) -> bytes:
        message = lcmt_panda_status()
        n = len(status.position)
        message.utime = message.robot_utime = round(1e6 * time)
        message.num_joints = n
        message.joint_position, message.joint_velocity = status.position.tolist(), status.velocity.tolist()
        message.joint_position_desired = status.commanded.tolist()
        for field in (
            "joint_velocity_desired",
            "joint_acceleration_desired",
            "joint_torque",
            "joint_torque_desired",
            "joint_torque_external",
        ):
            setattr(message, field, [0.0] * n)
        message.control_command_success_rate = 1.0
        message.control_mode = PandaControlMode.kPosition
        return message.encode()

    def decode_status(self, message: bytes) -> JointStatus:
        zeros = np.zeros(len(self.joints))
        size = len(self.encode_status(0.0, JointStatus(zeros, zeros, zeros)))
        return self._status(
            self._decode(lcmt_panda_status, message, size),
            "joint_position",
            "joint_velocity",
            "joint_position_desired",
        )


ALLEGRO, PANDA = _Allegro(), _Panda()


def require_hand_messages(description: HandDescription) -> None:
    """Looks whether Drake has messages for a hand.

    Joints alone do not tell: the LEAP hand's bear the names of the Allegro's.

    Raises:
        HandError: it is no Allegro hand by its name.
    """
    if not description.name.startswith("allegro"):
        raise HandError(
            f"hand '{description.name}' has no LCM messages; those whose name begins with allegro have: "
            "lcmt_allegro_command and lcmt_allegro_status"
        )
