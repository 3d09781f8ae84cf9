"""The master homes a drive: the method is checked, the numbers go in the drive's units, the end and its reason are told."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from canopen_proto.drives.axis import (
    DriveError,
    HomingError,
    HomingProgressed,
    ModeUnsupportedError,
    enable,
    home,
    home_if_needed,
    move_to,
    read_homing_methods,
    read_position,
    set_mode,
)
from canopen_proto.drives.axis.axis import AxisSettings
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.homing_methods import MAXON_HOMING, HomingMethod, HomingSwitch
from canopen_proto.drives.cia402.modes import HomingStatus, Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError
from canopen_proto.multiplexer import Mux
from canopen_proto.procedures.objects import write
from canopen_proto.procedures.runner import ProcedureFinished
from canopen_proto.simulation.drive.homing import METHODS
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.drives.rig import Rig

TRACK = Track(negative_limit=-50_000, positive_limit=60_000, home_switch=(-7_000, 9_000), index_offset=123, index_distance=5_000)
DEGREES = AxisSettings(counts_per_unit=1_000, homing_method=23, homing_speed=150, homing_zero_speed=60, homing_acceleration=2_000)


def rig_with(settings: AxisSettings = DEGREES, *, position: float = 20_000, reaction: int = 0) -> Rig:
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(position=position, track=TRACK, reaction=reaction))
    rig.axis.settings = settings
    return rig


def commanded(rig: Rig) -> int:
    return rig.drive._servo.parameter(objects.CONTROLWORD)


@pytest.mark.thorough(3)
@pytest.mark.parametrize(("method", "place"), [(1, -49_877), (7, -9_877), (14, -9_877), (18, 60_000), (23, -7_000), (34, 20_123)])
@pytest.mark.parametrize("reaction", [0, 300 * MILLISECOND])
def test_a_drive_is_homed_by_any_method(method: int, place: int, reaction: int) -> None:
    rig = rig_with(replace(DEGREES, homing_method=method), reaction=reaction)
    rig.run(home(rig.axis))
    assert rig.axis.is_homed
    assert rig.drive._servo.zero == place
    assert rig.run(read_position(rig.axis)) == pytest.approx(0, abs=1e-3)


def test_a_drives_list_decides() -> None:
    rig = rig_with()
    assert rig.run(read_homing_methods(rig.remote)) == tuple(METHODS)
    for method, name in ((36, "touch probe"), (-3, "the manufacturer's"), (15, "reserved")):
        rig.axis.settings = replace(DEGREES, homing_method=method)
        with pytest.raises(
            ModeUnsupportedError, match=rf"drive 5 does not home by method {method}: {name}: its list \(0x60E3\) has 1, 2,"
        ):
            rig.run(home(rig.axis))
    assert commanded(rig) == 0  # nothing was sent


def test_without_a_list_the_table_decides_and_manufacturers_methods_pass() -> None:
    rig = rig_with()
    rig.node.values.store[objects.SUPPORTED_HOMING_METHODS] = 0
    assert rig.run(read_homing_methods(rig.remote)) is None
    for method in (16, 36, 99):
        rig.axis.settings = replace(DEGREES, homing_method=method)
        with pytest.raises(
            ModeUnsupportedError, match=r"it has no list of its methods .*; nothing was sent.*canopen home --list"
        ):
            rig.run(home(rig.axis))
    assert commanded(rig) == 0
    rig.axis.settings = replace(DEGREES, homing_method=-2)
    with pytest.raises(Exception, match="0x6098"):  # sent, and refused by this drive
        rig.run(home(rig.axis))
    rig.axis.settings = replace(DEGREES, homing_method=19)
    with pytest.raises(HomingError):  # the table has it; the switch lies behind
        rig.run(home(rig.axis))


def test_a_makers_method_is_sent_as_any_other() -> None:
    onto_lower_limit = HomingMethod(HomingSwitch.NEGATIVE_LIMIT, start=-1, edge=1, last=-1)  # as 17, inward
    settings = DriveSettings(position=0, track=TRACK, own_homing=((-5, onto_lower_limit),))
    rig = Rig(Shape.STANDARD, pdos=False, drive=settings)
    rig.axis.settings = replace(DEGREES, homing_method=-5)
    with pytest.raises(ModeUnsupportedError):  # not in its list
        rig.run(home(rig.axis))
    rig.node.values.store[objects.SUPPORTED_HOMING_METHODS] = 0  # a drive without a list
    rig.run(home(rig.axis))
    assert rig.drive._servo.zero == -50_000


@pytest.mark.thorough(3)
@pytest.mark.parametrize("mechanics", [None, Mechanics()], ids=["lag", "mass"])
@pytest.mark.parametrize(("method", "place"), [(-1, 55_123), (-2, -49_877), (-3, 58_000), (-4, -52_000)])
def test_onto_a_hard_stop(method: int, place: int, mechanics: Mechanics | None) -> None:
    track = Track(-math.inf, math.inf, (-7_000, 9_000), 123, 5_000, ends=(-52_000, 58_000))
    settings = DriveSettings(position=0, track=track, own_homing=tuple(MAXON_HOMING.items()), mechanics=mechanics)
    rig = Rig(Shape.STANDARD, pdos=False, drive=settings)
    rig.axis.settings = replace(DEGREES, homing_method=method, homing_speed=20, homing_zero_speed=10)
    rig.node.values.store[objects.SUPPORTED_HOMING_METHODS] = 0  # a drive without a list
    rig.run(home(rig.axis))
    assert rig.drive._servo.zero == pytest.approx(place, abs=1)
    assert rig.run(read_position(rig.axis)) == pytest.approx(0, abs=0.01)
    assert -52_000 <= rig.drive._servo.position <= 58_000


def test_a_hard_stop_that_is_not_there_is_never_found() -> None:
    settings = DriveSettings(position=0, track=Track(), own_homing=tuple(MAXON_HOMING.items()))
    rig = Rig(Shape.STANDARD, pdos=False, drive=settings)
    rig.axis.settings = replace(DEGREES, homing_method=-4)
    rig.node.values.store[objects.SUPPORTED_HOMING_METHODS] = 0
    with pytest.raises(HomingError):  # the limit switch comes first
        rig.run(home(rig.axis))


@pytest.mark.parametrize("mechanics", [None, Mechanics()], ids=["lag", "mass"])
def test_an_axis_is_not_moved_through_a_hard_stop(mechanics: Mechanics | None) -> None:
    settings = DriveSettings(position=0, track=Track(-math.inf, math.inf, ends=(-1e9, 5_000)), mechanics=mechanics)
    rig = Rig(Shape.STANDARD, pdos=False, drive=settings)
    rig.axis.settings = DEGREES
    with pytest.raises(DriveError):
        rig.run(move_to(rig.axis, 20, timeout=20 * SECOND))
    assert rig.drive._servo.position <= 5_000


def test_speeds_acceleration_and_home_position_are_in_the_users_unit() -> None:
    settings = replace(
        DEGREES, homing_speed=25.0, homing_zero_speed=4.5, homing_acceleration=300.0, home_position=-90.0, direction=-1, offset=10
    )
    rig = rig_with(settings)
    rig.run(home(rig.axis))
    store = rig.node.values.store
    assert [store[key] for key in (objects.HOMING_SPEED_SEARCH_SWITCH, objects.HOMING_SPEED_SEARCH_ZERO)] == [25_000, 4_500]
    assert store[objects.HOMING_ACCELERATION] == 300_000
    assert store[objects.HOME_OFFSET] == 90_010
    assert rig.run(read_position(rig.axis)) == pytest.approx(-90)


def test_rates_are_rounded_down_and_the_acceleration_has_its_own_unit() -> None:
    rig = rig_with(replace(DEGREES, homing_method=35, homing_speed=0.0019, homing_acceleration=10.0, acceleration_unit=100.0))
    rig.run(home(rig.axis))
    assert rig.node.values.store[objects.HOMING_SPEED_SEARCH_SWITCH] == 1
    assert rig.node.values.store[objects.HOMING_ACCELERATION] == 100


def test_what_the_settings_leave_open_is_not_written() -> None:
    rig = rig_with(AxisSettings(counts_per_unit=1_000))
    before = dict(rig.node.values.store)
    rig.run(home(rig.axis))
    written = (objects.HOMING_METHOD, objects.HOME_OFFSET, objects.HOMING_SPEED_SEARCH_SWITCH, objects.HOMING_ACCELERATION)
    assert [rig.node.values.store[key] for key in written] == [before[key] for key in written]


@pytest.mark.parametrize(
    ("name", "value"),
    [("homing_speed", 0.0), ("homing_zero_speed", -1.0), ("homing_acceleration", float("inf")), ("homing_method", 128)],
)
def test_settings_that_cannot_be(name: str, value: float) -> None:
    with pytest.raises(LocalProtocolError, match=name):
        AxisSettings(**{name: value})  # type: ignore[arg-type]


def test_a_speed_that_would_be_0_on_the_wire_is_refused() -> None:
    rig = rig_with(replace(DEGREES, homing_speed=0.0004))
    with pytest.raises(LocalProtocolError, match=r"homing_speed = 0.0004 would be 0"):
        rig.run(home(rig.axis))


def test_a_home_offset_with_the_other_sign_is_noticed() -> None:
    rig = rig_with(replace(DEGREES, home_position=30.0, home_offset_reversed=True))  # this drive does not reverse it
    with pytest.raises(HomingError, match=r"other sign.*Try: AxisSettings\(home_offset_reversed=False\)"):
        rig.run(home(rig.axis))
    assert not rig.axis.is_homed


def test_a_failure_names_the_limit_switch_and_the_method() -> None:
    rig = rig_with(replace(DEGREES, homing_method=19))
    expected = r"reports a homing error: it stands on its positive limit switch \(0x60FD\); method 19: goes in positive direction"
    with pytest.raises(HomingError, match=expected):
        rig.run(home(rig.axis))
    assert not rig.axis.is_homed
    assert rig.axis.state is State.OPERATION_ENABLED
    rig.axis.settings = DEGREES  # and a method that turns finds the way back
    rig.run(home(rig.axis))
    assert rig.drive._servo.zero == -7_000


def test_progress_is_told() -> None:
    rig = rig_with()
    rig.run(home(rig.axis))
    told = [event for event in rig.bus.events if isinstance(event, HomingProgressed)]
    assert [event.status for event in told][-3:] == [HomingStatus.IN_PROGRESS, HomingStatus.ATTAINED, HomingStatus.COMPLETE]
    assert {event.node_id for event in told} == {5}


def test_a_drive_that_has_its_reference_need_not_home() -> None:
    rig = rig_with()
    assert rig.run(home_if_needed(rig.axis))
    assert not rig.run(home_if_needed(rig.axis))
    keeps = rig_with(replace(DEGREES, keeps_reference=True))
    assert not keeps.run(home_if_needed(keeps.axis))
    assert commanded(keeps) == 0
    joint = Rig(Shape.SCHUNK_POWERBALL)
    assert joint.run(home_if_needed(joint.axis))
    joint.axis.is_homed = False  # a new master, which reads bit 15
    assert not joint.run(home_if_needed(joint.axis))


def test_a_drive_that_moves_is_halted_before_it_gets_another_mode() -> None:
    """By the drive's own truth: it stands when its mode changes, and not only when it begins to home."""
    rig = rig_with(replace(DEGREES, homing_method=35))
    rig.run(set_mode(rig.axis, Mode.PROFILE_VELOCITY))
    rig.run(enable(rig.axis))
    rig.run(write(rig.remote, "0x60FF", 20_000))
    rig.bus.run(SECOND)
    rig.drive.refresh(rig.bus.now)
    assert rig.drive._servo.demand_velocity
    request = rig.master.run(home(rig.axis), rig.bus.now)
    rig.bus.run_until(lambda: rig.node.values.store[objects.MODES_OF_OPERATION] == Mode.HOMING, 10 * SECOND)
    rig.drive.refresh(rig.bus.now)
    assert not rig.drive._servo.demand_velocity
    assert isinstance(rig.outcome(request), ProcedureFinished)


def test_method_0_is_said_as_such_and_zeros_in_the_list_are_none() -> None:
    rig = Rig(Shape.STANDARD)
    rig.axis.settings = replace(rig.axis.settings, homing_method=0)
    with pytest.raises(
        ModeUnsupportedError, match="method 0: no homing: 0 stands for a drive that needs no homing, or for which"
    ):
        rig.run(home(rig.axis))
    places = range(1, int(rig.node.values.store[objects.SUPPORTED_HOMING_METHODS]) + 1)  # type: ignore[arg-type]
    for number in places:
        rig.node.values.store[Mux(objects.SUPPORTED_HOMING_METHODS + number)] = 35 if number == places[-1] else 0
    assert rig.run(read_homing_methods(rig.axis.node)) == (35,)
    rig.node.values.store[Mux(objects.SUPPORTED_HOMING_METHODS + places[-1])] = 0
    assert rig.run(read_homing_methods(rig.axis.node)) is None
    rig.axis.settings = replace(rig.axis.settings, homing_method=35)
    rig.run(home(rig.axis))
