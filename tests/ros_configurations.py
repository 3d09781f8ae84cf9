"""Configurations of ros_canopen and ros2_canopen, as their users have them.

They are not part of the project: they belong to their authors. They are looked for in `$CANOPEN_ROS_CONFIGS`, else in
`../shared/ros-configs` beside the repository; without them the tests are skipped.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

VARIABLE = "CANOPEN_ROS_CONFIGS"
FOLDER = Path(os.environ.get(VARIABLE) or Path(__file__).parents[1] / ".." / "shared" / "ros-configs")

needs_configurations = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"no configurations of others: there is no folder {FOLDER} (${VARIABLE} names another)"
)

SETS = (
    ("ros1-schunk-lwa4p-driver.yaml", "ros1-schunk-lwa4p-can0.yaml"),
    ("ros1-maxon-epos4-bus.yaml", "ros1-maxon-epos4-nodes.yaml"),
    ("ros1-roboteq-driver.yaml",),
    ("ros2-cia402-system-bus.yml",),
    ("ros2-cia402-multichannel-bus.yml",),
    ("ros2-simple-diagnostics-bus.yml",),
)
"""The files that belong together."""
