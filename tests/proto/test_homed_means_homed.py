"""Homed means homed: whatever the drive's delay, the cycle, and the way of the commands, and whichever homing it is.

The drive's own truth is the judge: `home` returns only when the drive stands at the reference that this homing found, and it
returns for each drive that found one.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto import drive
from canopen_proto.cia402 import objects
from canopen_proto.cia402.modes import HomingStatus
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.simulated_drive.homing import HomingFinished
from canopen_proto.simulated_drive.settings import DriveSettings, Shape, Track
from tests.examples import examples
from tests.proto.rig import Rig

REACTION_TIME = 1 * SECOND
MARGIN = 20 * MILLISECOND
"""What lies between a drive's answer and our hearing of it: frames, and the pause between two looks."""
TRACK = Track(home_switch=(-2_000.0, 2_000.0), index_distance=1_500.0)
METHODS = [19, 21, 33, 34, 35, 37]
PAIRS = [(first, then) for first in METHODS for then in METHODS if not (first in (33, 34) and then in (19, 21))]
"""Two homings in a row. Behind an index pulse the axis may stand beyond the home switch; 19 and 21 do not turn round there."""


def ways_of_commands() -> st.SearchStrategy[Time | None]:
    """The cycle of the SYNC by which commands go, or None: by SDO."""
    return (st.none() | st.integers(1, 4) | st.integers(1, 200)).map(lambda ms: ms and ms * MILLISECOND)


def rig_of(shape: Shape, reaction: Time, cycle: Time | None) -> Rig:
    rig = Rig(shape, drive=DriveSettings(shape=shape, position=1_000, reaction=reaction, track=TRACK))
    if cycle is not None:
        rig.sync.start(cycle, rig.bus.now)
        carrier = next(iter(rig.remote.rpdos))
        rig.remote.enable_rpdo(carrier, rig.bus.now)
    return rig


def home_and_judge(rig: Rig) -> None:
    """Home once more: what the drive itself knows at the very moment of the return."""
    finished = len(rig.bus.take_events(HomingFinished))
    assert finished == 0
    rig.run(drive.home(rig.axis))
    rig.drive.refresh(rig.bus.now)
    ended = [event.status for event in rig.bus.take_events(HomingFinished)]
    assert ended == [HomingStatus.COMPLETE], "it was believed before it was done"
    assert rig.drive._homing.is_referenced
    assert rig.drive._servo.is_settled
    assert rig.axis.is_homed
    assert rig.drive.values.store[objects.POSITION_ACTUAL_VALUE] == rig.drive.values.store.get(objects.HOME_OFFSET, 0)
    rig.bus.run(REACTION_TIME + 10 * MARGIN)
    assert not rig.bus.take_events(HomingFinished)
    assert rig.drive._servo.is_settled, "it moved afterwards"


@given(
    reaction=st.integers(0, (REACTION_TIME - MARGIN) // MILLISECOND).map(lambda ms: ms * MILLISECOND),
    cycle=ways_of_commands(),
    pair=st.sampled_from(PAIRS),
)
@example(reaction=80 * MILLISECOND, cycle=MILLISECOND, pair=(33, 35))
@example(reaction=900 * MILLISECOND, cycle=200 * MILLISECOND, pair=(33, 33))
@examples(8)
def test_a_drive_is_homed_when_it_stands_at_its_new_reference(reaction: Time, cycle: Time | None, pair: tuple[int, int]) -> None:
    rig = rig_of(Shape.STANDARD, reaction, cycle)
    for method in pair:
        rig.axis.settings = replace(rig.axis.settings, homing_method=method)
        home_and_judge(rig)


@given(
    reaction=st.integers(0, (REACTION_TIME - MARGIN) // MILLISECOND).map(lambda ms: ms * MILLISECOND),
    cycle=ways_of_commands(),
)
@example(reaction=80 * MILLISECOND, cycle=MILLISECOND)
@examples(4)
def test_a_schunk_is_homed_when_it_stands_at_its_new_reference(reaction: Time, cycle: Time | None) -> None:
    rig = rig_of(Shape.SCHUNK_POWERBALL, reaction, cycle)
    for _ in range(2):
        home_and_judge(rig)


@pytest.mark.parametrize("cycle", [None, 10 * MILLISECOND, 200 * MILLISECOND])
@pytest.mark.parametrize("reaction", [0, 80 * MILLISECOND, 900 * MILLISECOND])
def test_an_old_homing_error_does_not_fail_the_next_homing(reaction: Time, cycle: Time | None) -> None:
    rig = rig_of(Shape.STANDARD, reaction, cycle)
    rig.axis.settings = replace(rig.axis.settings, homing_method=None)
    rig.node.values.store[objects.HOMING_METHOD] = 0  # the drive's own: it has none
    with pytest.raises(drive.HomingFailed, match="homing error"):
        rig.run(drive.home(rig.axis))
    rig.bus.take_events(HomingFinished)
    rig.axis.settings = replace(rig.axis.settings, homing_method=33)
    home_and_judge(rig)


def test_a_homing_that_somebody_else_interrupts_is_told_within_the_reaction_time() -> None:
    rig = rig_of(Shape.STANDARD, 0, None)
    rig.axis.settings = replace(rig.axis.settings, homing_method=17)
    request = rig.master.run(drive.home(rig.axis), rig.bus.now)
    rig.bus.run(500 * MILLISECOND)
    interrupted_at = rig.bus.now
    rig.bus.send("605#2B4060000F000000")  # another master
    ended = rig.outcome(request)
    assert "stopped before it was homed: it was interrupted" in str(getattr(ended, "error", ended))
    assert rig.bus.now - interrupted_at < REACTION_TIME + SECOND
