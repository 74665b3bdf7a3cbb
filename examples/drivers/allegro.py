"""Drives an Allegro hand through Wonik's ROS 2 controller, from `geort-drake live --robot zmq+tcp://…:5557`.

    ros2 launch allegro_hand_controllers allegro_hand.launch.py HAND:=right
    python allegro.py

The controller calls the model's joint_0 to joint_15 joint_0.0 to joint_15.0, with the same signs, for a
right and for a left hand. Its own gains hold. Drake's driver over LCM needs none of this: `--robot lcm`.
"""

import argparse

from ros2_node import SPEED, run

from geort_drake.live.driver import FIRST_SPEED


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hand", default="allegroHand_0", help="namespace of the controller's topics")
    parser.add_argument("--endpoint", default="tcp://127.0.0.1:5557")
    parser.add_argument("--speed", type=float, default=FIRST_SPEED, help="fraction of 5 rad/s")
    options = parser.parse_args()
    topics = [f"/{options.hand}/{name}" for name in ("joint_cmd", "joint_states")]
    names = {f"joint_{number}": f"joint_{number}.0" for number in range(16)}
    run(*topics, options.endpoint, options.speed * SPEED, names)


if __name__ == "__main__":
    main()
