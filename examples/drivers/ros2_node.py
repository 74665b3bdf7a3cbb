"""Passes joint targets of any hand to ROS 2, and joint states back, as sensor_msgs/JointState.

    source /opt/ros/humble/setup.bash
    python ros2_node.py --targets /hand/joint_targets --states /hand/joint_states

Run `geort-drake live --robot zmq+tcp://127.0.0.1:5557` beside it. The node begins when all joints have been
reported. It limits the speed; limits of position are the controller's. When targets stop, it goes on
publishing the last ones; when states stop, it holds and reports a fault.
"""

import argparse
import time

import numpy as np
import rclpy
from sensor_msgs.msg import JointState

from geort_drake.live.driver import FIRST_SPEED, JointDriver

SPEED = 5.0  # rad/s
SILENCE = 0.5  # s without a joint's state that is a fault


def run(targets: str, states: str, endpoint: str, speed: float, names: dict[str, str] | None = None) -> None:
    """Runs the node.

    Args:
        targets, states: topics.
        endpoint: ZeroMQ endpoint of `geort-drake live`.
        speed: speed limit, rad/s.
        names: joint of the model → its name in the topics; None for the names in the first state.
    """
    rclpy.init()
    node = rclpy.create_node("geort_drake")
    # Topic's joint → rad, and when it came; a message may have any order, and a part of the joints.
    measured: dict[str, tuple[float, float]] = {}

    def receive(state: JointState) -> None:
        for name, position in zip(state.name, state.position, strict=True):
            measured[name] = position, time.monotonic()

    node.create_subscription(JointState, states, receive, 1)
    publisher = node.create_publisher(JointState, targets, 1)
    while rclpy.ok() and not (measured and measured.keys() >= {*(names or {}).values()}):
        rclpy.spin_once(node, timeout_sec=0.1)
    names = names or {name: name for name in measured}
    q = np.array([measured[name][0] for name in names.values()])
    unlimited = np.full(len(q), np.inf)
    with JointDriver(endpoint, list(names), q, -unlimited, unlimited, speed) as driver:
        while driver.running and rclpy.ok():
            rclpy.spin_once(node, timeout_sec=0.0)
            q = np.array([measured[name][0] for name in names.values()])
            oldest = min(names, key=lambda joint: measured[names[joint]][1])
            silent = time.monotonic() - measured[names[oldest]][1] > SILENCE
            message = JointState()
            message.header.stamp = node.get_clock().now().to_msg()
            message.name = list(names.values())
            message.position = driver.step(q, f"no state of {oldest} comes" if silent else "").tolist()
            publisher.publish(message)
    node.destroy_node()
    rclpy.try_shutdown()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--targets", default="/hand/joint_targets")
    parser.add_argument("--states", default="/hand/joint_states")
    parser.add_argument("--endpoint", default="tcp://127.0.0.1:5557")
    parser.add_argument("--speed", type=float, default=FIRST_SPEED, help="fraction of 5 rad/s")
    options = parser.parse_args()
    run(options.targets, options.states, options.endpoint, options.speed * SPEED)


if __name__ == "__main__":
    main()
