"""Carries joint targets to a robot and joint states back: JSON over ZeroMQ, or Drake's messages over LCM.

Addresses:
    zmq+tcp://HOST:PORT     `joint_messages`: targets are published at PORT, states come at PORT + 1
    zmq+ipc://PATH          the same, at PATH and PATH-state
    lcm, lcm+URL            an Allegro hand and a Panda arm, in Drake's `lcmt_allegro_*` and `lcmt_panda_*`

Messages are decoded here and not by Drake's LcmSubscriberSystem, which ends the program at a malformed one,
nor by its PandaStatusReceiver, which passes on numbers that are not finite.
"""

import math
import struct
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from drake import lcmt_allegro_command, lcmt_allegro_status, lcmt_panda_command, lcmt_panda_status
from pydrake.lcm import DrakeLcm
from pydrake.manipulation import PandaControlMode

from geort_drake.errors import HandError, LiveError
from geort_drake.hands.description import HandDescription
from geort_drake.live.joint_messages import Bus, JointState, JointTargets, open_driver_bus, open_zmq_bus
from geort_drake.live.transports import split_address


class LcmDevice(NamedTuple):
    """A hand or an arm on LCM that takes position commands.

    Attributes:
        channel: prefix of its LCM channels, `channel`_COMMAND and `channel`_STATUS.
        joints: names of the joints, in the order of the messages.
        command, status: Drake's message classes.
        count_field: field of a command with the number of its positions, which are in `joint_position`.
        measured: fields of a status with positions, velocities and commanded positions.
    """

    channel: str
    joints: tuple[str, ...]
    command: type
    status: type
    count_field: str
    measured: tuple[str, str, str]

    def encode_command(self, targets: JointTargets) -> bytes:
        """Returns the message that commands the targets' positions of the device's joints."""
        message: Any = self.command()
        message.utime = round(1e6 * targets.time)
        setattr(message, self.count_field, len(self.joints))
        message.joint_position = self._in_order(targets.names, targets.position)
        if self.command is lcmt_panda_command:
            message.control_mode_expected = PandaControlMode.kPosition
        return message.encode()

    def decode_command(self, data: bytes) -> JointTargets:
        """Returns the commanded positions as targets that do not move.

        Raises:
            LiveError: the message is malformed, for another number of joints, not finite, or for another
                control mode.
        """
        message = self._decode(self.command, data)
        q = self._joint_values(message, "joint_position")
        mode = getattr(message, "control_mode_expected", PandaControlMode.kPosition)
        if mode != PandaControlMode.kPosition:
            raise LiveError(f"{self.channel}: control_mode_expected must be 1, for positions, not {mode}")
        still = [0.0] * len(q)
        return JointTargets(0, 1e-6 * message.utime, list(self.joints), q, still, True, math.inf)

    def encode_status(self, state: JointState) -> bytes:
        """Returns the status of the device's joints. Fields that are not simulated are zero."""
        message: Any = self.status()
        message.utime, message.num_joints = round(1e6 * state.time), len(self.joints)
        # Each list in a status has one number per joint.
        for name in message.__slots__:
            if isinstance(getattr(message, name), list):
                setattr(message, name, [0.0] * len(self.joints))
        q, v = (self._in_order(state.names, values) for values in (state.position, state.velocity))
        for name, values in zip(self.measured, (q, v, q), strict=True):
            setattr(message, name, values)
        if self.status is lcmt_panda_status:
            message.control_mode, message.control_command_success_rate = PandaControlMode.kPosition, 1.0
        return message.encode()

    def decode_status(self, data: bytes) -> JointState:
        """Returns the state in a status.

        Raises:
            LiveError: the message is malformed, of another number of joints, or not finite.
        """
        message = self._decode(self.status, data)
        q, v, _ = (self._joint_values(message, field) for field in self.measured)
        return JointState(0, 1e-6 * message.utime, list(self.joints), q, v)

    def _in_order(self, names: Sequence[str], values: Sequence[float]) -> list[float]:
        by_name = dict(zip(names, values, strict=True))
        return [by_name[name] for name in self.joints]

    def _decode(self, kind: Any, data: bytes) -> Any:
        try:
            return kind.decode(data)
        except (ValueError, struct.error) as error:
            raise LiveError(f"{self.channel}: {kind.__name__} cannot be decoded: {error}") from None

    def _joint_values(self, message: Any, field: str) -> list[float]:
        values = list(getattr(message, field))
        if len(values) != len(self.joints) or not all(map(math.isfinite, values)):
            raise LiveError(
                f"{self.channel}: {field} must be {len(self.joints)} finite numbers, not {values!s:.80}. Is "
                "this the hand that the robot has?"
            )
        return values


ALLEGRO = LcmDevice(
    "ALLEGRO",
    tuple(f"joint_{i}" for i in range(16)),
    lcmt_allegro_command,
    lcmt_allegro_status,
    "num_joints",
    ("joint_position_measured", "joint_velocity_estimated", "joint_position_commanded"),
)
PANDA = LcmDevice(
    "PANDA",
    tuple(f"panda_joint{i}" for i in range(1, 8)),
    lcmt_panda_command,
    lcmt_panda_status,
    "num_joint_position",
    ("joint_position", "joint_velocity", "joint_position_desired"),
)
_DEVICES = (ALLEGRO, PANDA)


class LcmBus(Bus[Any, Any]):
    """Drake's messages for all devices on an LCM bus.

    Args:
        url: LCM URL.
        driver: whether this is the driver's end, which receives commands and sends statuses.
    """

    arm_is_required = True

    def __init__(self, url: str, driver: bool):
        super().__init__()
        self._lcm, self._driver = DrakeLcm(url), driver
        self._arrived: list[tuple[Callable[[bytes], Any], bytes]] = []
        for device in _DEVICES:
            decode = device.decode_command if driver else device.decode_status
            self._lcm.Subscribe(
                f"{device.channel}_{'COMMAND' if driver else 'STATUS'}",
                lambda message, decode=decode: self._arrived.append((decode, message)),
            )

    def send(self, message: Any) -> None:
        for device in _DEVICES:
            if self._driver:
                self._lcm.Publish(f"{device.channel}_STATUS", device.encode_status(message))
            else:
                self._lcm.Publish(f"{device.channel}_COMMAND", device.encode_command(message))

    def _arrivals(self) -> Iterable[tuple[Callable[[bytes], Any], bytes]]:
        # LCM keeps only one message per channel, so this must be called often.
        self._lcm.HandleSubscriptions(0)
        arrivals, self._arrived = self._arrived, []
        return arrivals


def open_bus(address: str, description: HandDescription, driver: bool = False) -> Bus:
    """Opens a robot's address, or with `driver` the driver's end of it.

    Raises:
        LiveError: the address is malformed or in use.
        HandError: the hand has no LCM messages.
    """
    pattern, endpoint = split_address(address, ("zmq", "lcm"))
    if pattern == "zmq":
        return open_driver_bus(endpoint) if driver else open_zmq_bus(endpoint)
    # By its name, because LEAP's joints are named like the Allegro's.
    if not description.name.startswith("allegro"):
        raise HandError(
            f"hand '{description.name}' has no LCM messages; only hands whose name begins with allegro have: "
            "lcmt_allegro_command and lcmt_allegro_status. Every hand can be driven over ZeroMQ: "
            "zmq+tcp://127.0.0.1:5557"
        )
    return LcmBus(endpoint, driver)
