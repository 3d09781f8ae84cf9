"""Homed means homed: whatever the drive's delay, the cycle, and the way of the commands, and whichever homing it is.

The drive's own truth is the judge: `home` returns only when the drive stands at the reference that this homing found, and it
returns for each drive that found one.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import HomingStatus, Mode
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.procedures.steps import ProcedureError
from canopen_proto.simulation.drive.homing import HomingFinished
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.drives.rig import Rig
from tests.examples import examples

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


@pytest.mark.thorough(4)
@pytest.mark.parametrize("cycle", [None, 10 * MILLISECOND, 200 * MILLISECOND])
@pytest.mark.parametrize("reaction", [0, 80 * MILLISECOND, 900 * MILLISECOND])
def test_an_old_homing_error_does_not_fail_the_next_homing(reaction: Time, cycle: Time | None) -> None:
    rig = rig_of(Shape.STANDARD, reaction, cycle)
    rig.axis.settings = replace(rig.axis.settings, homing_method=None)
    rig.node.values.store[objects.HOMING_METHOD] = 0  # the drive's own: it has none
    with pytest.raises(drive.HomingError, match="homing error"):
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


SLOW_METHODS = [1, 17, 19, 21, 33, 34, 35, 37, 0]


@given(
    reaction=st.integers(0, 10_000).map(lambda ms: ms * MILLISECOND),
    cycle=st.sampled_from([None, None, 10 * MILLISECOND]),
    methods=st.lists(st.sampled_from(SLOW_METHODS), min_size=1, max_size=3),
    pauses=st.lists(st.integers(0, 12_000).map(lambda ms: ms * MILLISECOND), min_size=3, max_size=3),
    was_homed=st.booleans(),
    shape=st.sampled_from(Shape),
    was_enabled=st.booleans(),
)
@example(2_900 * MILLISECOND, None, [35], [0] * 3, True, Shape.STANDARD, True)
@example(9_000 * MILLISECOND, None, [35], [0] * 3, True, Shape.STANDARD, True)
@examples(5)
def test_however_late_a_drive_acts_and_however_often_one_tries_again_homed_means_homed(
    reaction: Time,
    cycle: Time | None,
    methods: list[int],
    pauses: list[Time],
    was_homed: bool,
    shape: Shape,
    was_enabled: bool,
) -> None:
    """An error is an answer, too. was_homed, was_enabled: somebody else has homed the drive before, or left it enabled."""
    rig = rig_of(shape, reaction, cycle)
    if was_homed or was_enabled:
        patient = Axis(rig.remote, replace(rig.axis.settings, reaction_time=25 * SECOND, state_timeout=25 * SECOND))
        patient.settings = replace(patient.settings, homing_method=35, homing_timeout=300 * SECOND)
        rig.run(drive.home(patient) if was_homed else drive.enable(patient))
        if not was_enabled:
            rig.run(drive.shut_down(patient))
            if cycle is not None:
                rig.remote.enable_rpdo(next(iter(rig.remote.rpdos)), rig.bus.now)
        rig.bus.run(25 * SECOND)
        rig.axis = Axis(rig.remote, rig.axis.settings)
    rig.bus.take_events(HomingFinished)
    for number, pause in enumerate(pauses):
        rig.axis.settings = replace(rig.axis.settings, homing_method=methods[number % len(methods)])
        try:
            rig.run(drive.home(rig.axis))
        except ProcedureError:
            rig.bus.run(pause)
            assert not rig.axis.is_homed
            rig.bus.take_events(HomingFinished)
            continue
        rig.drive.refresh(rig.bus.now)
        ended = [event.status for event in rig.bus.take_events(HomingFinished)]
        assert ended[-1:] == [HomingStatus.COMPLETE], "it was believed before it was done"
        assert rig.drive._homing.is_referenced
        assert rig.drive._servo.is_settled
        stood = rig.drive._servo.position
        rig.bus.run(12 * SECOND)
        rig.drive.refresh(rig.bus.now)
        assert not rig.bus.take_events(HomingFinished)
        assert rig.drive._servo.position == stood, "it moved afterwards"
        return


@pytest.mark.thorough(5)
@pytest.mark.parametrize("method", [1, 17, 33, 34, 35])
@pytest.mark.parametrize("reaction", [1_100, 1_500, 2_900])
def test_a_drive_that_answers_late_is_given_its_time(reaction: int, method: int) -> None:
    """How late it answers was seen when it was enabled."""
    rig = rig_of(Shape.STANDARD, reaction * MILLISECOND, None)
    rig.axis.settings = replace(rig.axis.settings, homing_method=method)
    home_and_judge(rig)


def test_a_homing_that_did_not_begin_may_still_begin_and_the_next_one_waits_for_that() -> None:
    rig = rig_of(Shape.STANDARD, MILLISECOND, None)
    rig.axis.settings = replace(rig.axis.settings, homing_method=17)
    rig.run(drive.set_mode(rig.axis, Mode.HOMING))
    rig.run(drive.enable(rig.axis))
    at_once, late = rig.drive.settings, replace(rig.drive.settings, reaction=4 * SECOND)
    rig.drive.settings = late  # it has got slow since it was enabled
    with pytest.raises(
        drive.HomingError, match=r"did not begin to home within 1 s \(reaction_time\), and may still begin"
    ) as told:
        rig.run(drive.home(rig.axis))
    assert "a longer reaction_time in its settings" in told.value.remedy
    with pytest.raises(drive.DriveTimeoutError, match=r"within 3 s \(state_timeout\), and may still obey a homing"):
        rig.run(drive.home(rig.axis))
    rig.drive.settings = at_once
    rig.bus.run(10 * SECOND)
    rig.bus.take_events(HomingFinished)
    home_and_judge(rig)
