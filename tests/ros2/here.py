"""Whether this process may use rclpy."""

from __future__ import annotations

import importlib.util
import socket
import sys


def missing() -> str:
    """Return what is missing for these tests, or "". Only loopback may be there: DDS finds its peers by multicast."""
    if sys.platform != "linux" or importlib.util.find_spec("rclpy") is None:
        return "ROS 2 NOT TESTED: there is no rclpy here (tests/ros2/README.md)"
    if [name for _, name in socket.if_nameindex()] != ["lo"]:
        return "ROS 2 NOT TESTED: this process can reach a network; begin with tests/ros2/run (tests/ros2/README.md)"
    return ""


MISSING = missing()
