"""The demonstration's path: smooth, at rest at both ends, and never too fast to be halted."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_master.demonstration.swing import MAX_ACCELERATION, MAX_SPEED, SwingPath

STEP = 0.002


@given(st.floats(0.5, 20), st.floats(0.001, 1.1), st.integers(1, 7), st.floats(0, 1), st.none() | st.floats(0.01, 3))
def test_speed_and_acceleration_are_limited(
    duration: float, swing: float, joints: int, share: float, slower: float | None
) -> None:
    path = SwingPath([0.0] * joints, swing, duration, [] if slower is None else [slower] * joints)
    fastest = MAX_SPEED if slower is None else min(MAX_SPEED, slower)
    before, here, after = (path.at(share * duration + offset) for offset in (-STEP, 0, STEP))
    for a, b, c in zip(before, here, after, strict=True):
        assert abs(b) <= swing
        assert abs(c - a) / (2 * STEP) <= fastest * 1.01
        assert abs(a - 2 * b + c) / STEP**2 <= MAX_ACCELERATION * 1.01


@pytest.mark.parametrize("time", [-1.0, 0.0, 5.0, 9.0])
def test_it_begins_and_ends_where_the_joints_stand(time: float) -> None:
    assert SwingPath([0.1, -0.2], 0.3, 5.0).at(time) == pytest.approx([0.1, -0.2])


def test_five_seconds_are_enough_for_the_whole_swing() -> None:
    path = SwingPath([0.0] * 6, math.radians(15), 5.0)
    for joint in range(6):
        assert max(abs(path.at(n * 0.01)[joint]) for n in range(500)) > math.radians(13)
