"""Drives a Wuji hand from `geort-drake live --hand wuji_right --robot zmq+tcp://127.0.0.1:5557`.

    pip install wujihandpy pyzmq
    python wuji.py --side right

The vendor's model calls the thumb's joints right_finger1_joint1 to right_finger1_joint4; `geort-drake hand
list` says how to get it. The hand's own limits hold. Ctrl-C disables the motors.
"""

import argparse

import numpy as np
import wujihandpy

from geort_drake.live.driver import FIRST_SPEED, JointDriver

SPEED = 6.0  # rad/s
CUTOFF_HZ = 10.0  # of the hand's own low-pass filter


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--side", choices=["right", "left"], default="right")
    parser.add_argument("--speed", type=float, default=FIRST_SPEED, help="fraction of the motors' speed")
    parser.add_argument("--endpoint", default="tcp://127.0.0.1:5557")
    options = parser.parse_args()
    hand = wujihandpy.Hand()
    # Arrays have a row for each finger and a column for each joint.
    names = [f"{options.side}_finger{finger}_joint{joint}" for finger in range(1, 6) for joint in range(1, 5)]
    lower, upper = hand.read_joint_lower_limit().ravel(), hand.read_joint_upper_limit().ravel()
    q = hand.read_joint_actual_position().ravel()
    hand.write_joint_target_position(q.reshape(5, 4))
    hand.write_joint_enabled(True)
    controller = hand.realtime_controller(True, wujihandpy.filter.LowPass(CUTOFF_HZ))
    try:
        with JointDriver(options.endpoint, names, q, lower, upper, options.speed * SPEED) as driver:
            while driver.running:
                measured = np.asarray(controller.get_joint_actual_position()).ravel()
                errors = np.flatnonzero(hand.get_joint_error_code())
                fault = f"{names[errors[0]]} reports an error" if len(errors) else ""
                controller.set_joint_target_position(driver.step(measured, fault).reshape(5, 4))
    finally:
        controller.close()
        hand.write_joint_enabled(False)


if __name__ == "__main__":
    main()
