"""Fixtures of the tests of the ROS 1 node: see ros_world.py."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ros1.ros_world import Drives, Ros


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[Ros]:
    """A ROS environment; all its processes are ended with the test."""
    with Ros(tmp_path) as ros:
        yield ros


@pytest.fixture
def drives() -> Iterator[Drives]:
    with Drives() as drives:
        yield drives
