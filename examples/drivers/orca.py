"""Drives an ORCA hand from `geort-drake live --hand orca_right --robot zmq+tcp://127.0.0.1:5557`.

    pip install orca_core pyzmq
    python orca.py --model orca_core/models/v2/orcahand-right/config.yaml --prefix right_

Tension and calibrate the hand with the vendor's scripts first. Its package calls a joint index_mcp and counts
degrees; the vendor's model adds a prefix to the names, which `--prefix` tells. The wrist stays. Ctrl-C
disables the motors.
"""

import argparse

import numpy as np
from orca_core import MockOrcaHand, OrcaHand

from geort_drake.live.driver import FIRST_SPEED, JointDriver

SPEED = 5.0  # rad/s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", help="config.yaml of the hand (default: the package's)")
    parser.add_argument("--prefix", default="", help="what the model's joint names begin with")
    parser.add_argument("--speed", type=float, default=FIRST_SPEED, help="fraction of the motors' speed")
    parser.add_argument("--endpoint", default="tcp://127.0.0.1:5557")
    parser.add_argument("--mock", action="store_true", help="simulated motors, by the vendor")
    options = parser.parse_args()
    hand = (MockOrcaHand if options.mock else OrcaHand)(options.model)
    connected, message = hand.connect(interactive=False)
    if not connected:
        raise SystemExit(message)
    if not hand.calibrated and not options.mock:
        raise SystemExit("calibrate the hand first, with the vendor's script")
    joints = [joint for joint in hand.config.joint_ids if joint != "wrist"]
    lower, upper = np.radians([hand.config.joint_roms_dict[joint] for joint in joints]).T

    def measured() -> np.ndarray:
        return np.radians(hand.get_joint_position().as_array(joints).astype(float))

    q = measured()
    hand.enable_torque()
    names = [f"{options.prefix}{joint}" for joint in joints]
    try:
        with JointDriver(options.endpoint, names, q, lower, upper, options.speed * SPEED) as driver:
            while driver.running:
                degrees = np.degrees(driver.step(measured())).tolist()
                hand.set_joint_positions(dict(zip(joints, degrees, strict=True)))
    finally:
        hand.disable_torque()
        hand.disconnect()


if __name__ == "__main__":
    main()
