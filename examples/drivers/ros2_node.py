"""Passes joint targets of any hand to ROS 2, and joint states back, as sensor_msgs/JointState.

    source /opt/ros/humble/setup.bash
    python ros2_node.py --targets /hand/joint_targets --states /hand/joint_states

Run `geort-drake live --robot zmq+tcp://127.0.0.1:5557` beside it. The node begins when the first states have
come. It limits the speed; limits of position are the controller's. When targets stop, it goes on publishing
the last ones.
"""

import argparse

import numpy as np
import rclpy
from sensor_msgs.msg import JointState

from geort_drake.live.driver import FIRST_SPEED, JointDriver

SPEED = 5.0  # rad/s


def run(targets: str, states: str, endpoint: str, speed: float, names: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        targets, states: topics.
        endpoint: ZeroMQ endpoint of `geort-drake live`.
        speed: speed limit, rad/s.
        names: the model's names of the joints in the order of the first state, which contains all of them;
            None for the names there.
    """
    rclpy.init()
    node = rclpy.create_node("geort_drake")
    positions: dict[str, float] = {}  # joint → rad; a message may have any order, and a part of the joints
    node.create_subscription(
        JointState, states, lambda state: positions.update(zip(state.name, state.position, strict=True)), 1
    )
    publisher = node.create_publisher(JointState, targets, 1)
    while rclpy.ok() and not positions:
        rclpy.spin_once(node, timeout_sec=0.1)
    topic_names, q = list(positions), np.array(list(positions.values()))
    unlimited = np.full(len(q), np.inf)
    with JointDriver(endpoint, names or topic_names, q, -unlimited, unlimited, speed) as driver:
        while driver.running and rclpy.ok():
            rclpy.spin_once(node, timeout_sec=0.0)
            message = JointState()
            message.header.stamp = node.get_clock().now().to_msg()
            message.name = topic_names
            q = np.array([positions[name] for name in topic_names])
            message.position = driver.step(q).tolist()
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
