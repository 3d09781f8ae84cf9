"""`move_to` keeps to min_position and max_position of the settings, before anything is sent."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.datatypes import ValueRangeError
from canopen_proto.drives import axis as drive
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State, StatusBit
from canopen_proto.machine import SECOND
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.drives.rig import MILLIDEGREES, Rig
from tests.examples import examples

LIMITS = replace(MILLIDEGREES, min_position=-0.2, max_position=0.5)


@given(direction=st.sampled_from([1, -1]), relative=st.booleans(), amount=st.floats(-1, 1))
@example(direction=1, relative=False, amount=1.0)
@examples(8)
def test_no_move_goes_beyond_the_limits_of_the_settings(direction: int, relative: bool, amount: float) -> None:
    """A move that would is refused, with nothing sent."""
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.axis.settings = replace(LIMITS, direction=direction, offset=3_000)  # it stands at 0
    written = writes_of(rig)
    try:
        rig.run(drive.move_to(rig.axis, amount, timeout=60 * SECOND, relative=relative))
    except drive.LimitReachedError as refused:
        assert not -0.2 <= amount <= 0.5
        assert ("max_position" if amount > 0 else "min_position") in str(refused)
        assert writes_of(rig) == written
        return
    assert -0.2 <= amount <= 0.5
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(amount, abs=1e-3)


def writes_of(rig: Rig) -> int:
    """How many requests of the master change something in the drive."""
    return sum(frame.can_id == 0x605 and frame.data[0] & 0xE0 == 0x20 for _, frame in rig.bus.sent)


def test_a_drive_beyond_a_limit_may_come_back() -> None:
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(position=60_000))
    rig.axis.settings = LIMITS
    with pytest.raises(drive.LimitReachedError):
        rig.run(drive.move_to(rig.axis, 1.1, timeout=60 * SECOND))
    rig.run(drive.move_to(rig.axis, 0.9, timeout=60 * SECOND))
    rig.run(drive.move_to(rig.axis, -0.6, timeout=60 * SECOND, relative=True))
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(0.3, abs=1e-3)


@pytest.mark.parametrize("beyond", ["software limit", "limit switch"])
def test_a_drive_moves_away_from_an_internal_limit(beyond: str) -> None:
    """Bit 11 is named while the drive stands there, and keeps it from nothing that leads away."""
    switch = 40_000 if beyond == "limit switch" else 1e9
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(position=0, track=Track(positive_limit=switch)))
    rig.axis.settings = replace(MILLIDEGREES, counts_per_unit=1.0)
    if beyond == "software limit":
        rig.node.values.store[objects.MIN_SOFTWARE_POSITION_LIMIT] = -40_000
        rig.node.values.store[objects.MAX_SOFTWARE_POSITION_LIMIT] = 40_000
    with pytest.raises(drive.LimitReachedError):
        rig.run(drive.move_to(rig.axis, 90_000, timeout=60 * SECOND))
    rig.run(drive.move_to(rig.axis, 10_000, timeout=60 * SECOND))
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(10_000, abs=20)
    assert not rig.axis.statusword & StatusBit.INTERNAL_LIMIT


@pytest.mark.parametrize("relative", [False, True])
def test_a_target_that_0x607a_cannot_hold_is_refused_before_the_drive_has_power(relative: bool) -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.axis.settings = MILLIDEGREES
    with pytest.raises(ValueRangeError, match="0x607A"):
        rig.run(drive.move_to(rig.axis, 1e6, relative=relative, timeout=SECOND))
    assert rig.drive.state is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize("along", [False, True])
def test_a_profile_velocity_beyond_max_speed_is_refused(along: bool) -> None:
    """0x6081 is the drive's own: another tool may have left it."""
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.axis.settings = replace(MILLIDEGREES, counts_per_unit=1000.0, max_speed=10.0)

    def move(**velocity: float) -> None:
        if along:
            rig.run(drive.move_along(rig.axis, [drive.ProfileTarget(5.0, **velocity)], timeout=60 * SECOND))
        else:
            rig.run(drive.move_to(rig.axis, 5.0, timeout=60 * SECOND))

    rig.node.values.store[objects.PROFILE_VELOCITY] = 20_000
    written = writes_of(rig)
    with pytest.raises(
        drive.LimitReachedError, match=r"at 20 per second: .*0x6081 = 20000.*\(max_speed\) say 10; nothing was sent"
    ):
        move()
    assert writes_of(rig) == written
    if along:
        move(velocity=10.0)
    rig.node.values.store[objects.PROFILE_VELOCITY] = 10_000
    move()
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(5.0, abs=0.02)
    rig.axis.settings = replace(rig.axis.settings, max_speed=math.inf)
    rig.node.values.store[objects.PROFILE_VELOCITY] = 20_000
    move()
