"""Says why the tests of this folder are left out, where they are."""

from __future__ import annotations

import os

import pytest

from tests.ros2.here import MISSING


@pytest.mark.skipif(bool(MISSING), reason=MISSING)
def test_ros2_is_here_and_stays_on_this_computer() -> None:
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
