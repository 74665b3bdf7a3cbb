"""Drives a LEAP hand with Dynamixel motors from `geort-drake live --hand leap_right --robot zmq+tcp://…:5557`.

    pip install dynamixel-sdk pyzmq && python leap.py --port /dev/ttyUSB0

Motors run in current-based position mode, so that a blocked finger pushes no harder than `--current`. The
model's joint_5 is motor 5, and its zero is the motor's 180°. When the driver ends, the motors are limp.
"""

import argparse

import numpy as np
from dynamixel_sdk import GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

from geort_drake.live.driver import FIRST_SPEED, JointDriver

# Addresses in the control table of an XL330 or XC330, and sizes in bytes; the motors' speed is in rad/s.
MODE, TORQUE = (11, 1), (64, 1)
GAIN_D, GAIN_I, GAIN_P, CURRENT, GOAL, PRESENT = (80, 2), (82, 2), (84, 2), (102, 2), (116, 4), (132, 4)
CURRENT_BASED_POSITION, TICKS, BAUD, SPEED = 5, 4096, 4_000_000, 7.0
NAMES = [f"joint_{motor}" for motor in range(16)]
# The model's limits, rad: of a finger's abduction and three flexions, and of the thumb.
LOWER = np.array([-1.047, -0.314, -0.506, -0.366] * 3 + [-0.349, -0.47, -1.2, -1.34])
UPPER = np.array([1.047, 2.23, 1.885, 2.042] * 3 + [2.094, 2.443, 1.9, 1.88])


class Leap:
    """The hand's 16 motors on one bus."""

    def __init__(self, port: str, current: int):
        self.port, self.packets = PortHandler(port), PacketHandler(2.0)
        if not (self.port.openPort() and self.port.setBaudRate(BAUD)):
            raise SystemExit(f"{port}: cannot be opened at {BAUD} baud")
        self.reader = GroupSyncRead(self.port, self.packets, *PRESENT)
        for motor in range(16):
            self.reader.addParam(motor)
        self.write(TORQUE, 0)  # the mode is locked while a motor has torque
        registers = {MODE: CURRENT_BASED_POSITION, GAIN_P: 600, GAIN_I: 0, GAIN_D: 200, CURRENT: current}
        for register, value in registers.items():
            self.write(register, value)

    def write(self, register: tuple[int, int], values: int | np.ndarray) -> None:
        """Writes one value for each motor."""
        group = GroupSyncWrite(self.port, self.packets, *register)
        for motor, value in enumerate(np.broadcast_to(values, 16)):
            group.addParam(motor, int(value).to_bytes(register[1], "little"))
        if group.txPacket() != 0:
            raise SystemExit("the motors cannot be reached")

    def move(self, q: np.ndarray) -> None:
        """Commands joint positions (16,), rad."""
        self.write(GOAL, np.round((q + np.pi) * TICKS / (2.0 * np.pi)))

    def read(self) -> np.ndarray:
        """Returns the joint positions (16,), rad; NaN if an answer was lost."""
        if self.reader.txRxPacket() != 0:
            return np.full(16, np.nan)
        ticks = np.array([self.reader.getData(motor, *PRESENT) for motor in range(16)], np.uint32)
        return ticks.view(np.int32) * (2.0 * np.pi / TICKS) - np.pi


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", required=True)
    parser.add_argument("--current", type=int, default=300, help="limit of a motor's current, mA")
    parser.add_argument("--speed", type=float, default=FIRST_SPEED, help="fraction of the motors' speed")
    parser.add_argument("--endpoint", default="tcp://127.0.0.1:5557")
    options = parser.parse_args()
    hand = Leap(options.port, options.current)
    try:
        with JointDriver(options.endpoint, NAMES, hand.read(), LOWER, UPPER, options.speed * SPEED) as driver:
            hand.move(driver.step(hand.read()))  # where they stand
            hand.write(TORQUE, 1)
            while driver.running:
                hand.move(driver.step(hand.read()))
    finally:
        hand.write(TORQUE, 0)


if __name__ == "__main__":
    main()
