"""These tests need rclpy, and no network but loopback. test_here.py says what is missing, the rest is left out."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ros2.here import MISSING

if MISSING:
    collect_ignore_glob = ["test_[!h]*.py"]
else:
    from tests.ros2.arm import Arm
    from tests.ros2.client import Client

    @pytest.fixture
    def client() -> Iterator[Client]:
        """A ROS 2 node of this process."""
        with Client() as made:
            yield made

    @pytest.fixture
    def arm(tmp_path: Path) -> Iterator[Arm]:
        """Six simulated drives in a process of their own: they outlive the node."""
        with Arm(tmp_path) as made:
            yield made
