"""`python -m canopen_ros.ros2.await_joints JOINT...`: wait until one message on joint_states has all these joints, then end.

Controllers begin where the joints are, so the launch file starts them behind it. It has no time limit, since drives may get their
supply later; every 10 s it says which joints are missing. The topic can be remapped: `--ros-args -r joint_states:=/other`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Final

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import JointState as JointStateType

from canopen_ros.ros2.rcl import JointState, Logger

REMINDER: Final = 10.0
"""Seconds between two lines about what is missing."""


class Waiting:
    """missing: the joints that were not in the message with the most of them; none are left when it may end."""

    def __init__(self, node: Node, joints: Sequence[str]) -> None:
        self.missing = list(joints)
        self._joints = tuple(joints)
        self._logger: Logger = node.get_logger()
        # Best effort, which hears reliable publishers, too
        node.create_subscription(JointStateType, "joint_states", self._hear, qos_profile_sensor_data)
        node.create_timer(REMINDER, self._remind)
        self._logger.info(f"waiting for the joint states of {', '.join(joints)}")

    def _hear(self, message: JointState) -> None:
        missing = [joint for joint in self._joints if joint not in message.name]
        if len(missing) < len(self.missing):
            self.missing = missing

    def _remind(self) -> None:
        self._logger.warning(f"no joint states of {', '.join(self.missing)} yet: are their drives on the bus, with power?")


def main(argv: Sequence[str]) -> int:
    """Wait; return the exit status: 0 if all joints were heard, 1 if it was interrupted before."""
    joints = remove_ros_args(list(argv))[1:]
    if not joints:
        print("usage: python -m canopen_ros.ros2.await_joints JOINT...", file=sys.stderr)
        return 2
    rclpy.init(args=list(argv))
    try:
        node = Node("await_joints")
        waiting = Waiting(node, joints)
        while waiting.missing:
            rclpy.spin_once(node)
        node.get_logger().info("all joint states are there")
    except (KeyboardInterrupt, ExternalShutdownException):
        return 1
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv))
