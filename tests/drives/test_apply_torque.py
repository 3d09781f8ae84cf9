"""Profile torque from the master's side: a torque for a time, within limits, and the drive stands afterwards."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from canopen_proto.datatypes import ValueRangeError
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives import axis as drive
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import ControlBit, State
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, LocalProtocolError
from canopen_proto.procedures.runner import ProcedureCancelled
from canopen_proto.procedures.steps import ProcedureError
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.drives.rig import Rig

JOINT = Mechanics()
ENDLESS = Track(-math.inf, math.inf)


def rig_of(mechanics: Mechanics = JOINT, *, coasts: bool = False, **settings: Any) -> Rig:
    """A joint with a mass, which stands at 0. settings: of its axis."""
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(position=0, mechanics=mechanics, track=ENDLESS, coasts=coasts))
    rig.axis.settings = replace(rig.axis.settings, **settings)
    rig.node.values.store[objects.TORQUE_SLOPE] = 10_000
    return rig


def velocity_of(rig: Rig) -> float:
    rig.drive.refresh(rig.bus.now)
    return rig.drive._servo.velocity


def stands(rig: Rig) -> None:
    """It stands, no target is left, and nothing moves it later."""
    for _ in range(2):
        assert abs(velocity_of(rig)) < 10
        assert rig.node.values.store[objects.TARGET_TORQUE] == 0
        assert rig.remote.values.store[objects.TARGET_TORQUE] == 0
        rig.bus.run(SECOND)


def test_a_torque_is_applied_for_its_time_and_the_drive_is_halted() -> None:
    rig = rig_of(max_speed=2.0)
    began = rig.bus.now
    request = rig.master.run(drive.apply_torque(rig.axis, 0.0804, 300 * MILLISECOND, slope=10.0), rig.bus.now)
    rig.bus.run(250 * MILLISECOND)
    assert rig.drive.mode == Mode.TORQUE
    assert rig.node.values.store[objects.TORQUE_ACTUAL_VALUE] == 80
    assert rig.node.values.store[objects.TORQUE_SLOPE] == 10_000
    assert velocity_of(rig) > 1_000
    ended = rig.outcome(request)
    assert ended.result == 0.08  # type: ignore[union-attr]
    assert rig.bus.now - began < 2 * SECOND
    assert rig.axis.controlword & ControlBit.HALT
    assert rig.drive.state is State.OPERATION_ENABLED
    stands(rig)


@pytest.mark.parametrize(
    ("settings", "asked"), [({}, None), ({}, math.inf), ({"max_speed": 0.5}, 3.0), ({"max_speed": 3.0}, 0.5)]
)
def test_without_any_limit_of_the_speed_nothing_is_done_and_the_lower_one_counts(
    settings: dict[str, float], asked: float | None
) -> None:
    rig = rig_of(**settings)
    procedure = drive.apply_torque(rig.axis, 0.1, SECOND, max_speed=asked)
    if not settings and asked is None:
        with pytest.raises(drive.DriveError, match="nothing limits its speed"):
            rig.run(procedure)
        assert rig.drive.state is State.SWITCH_ON_DISABLED
        assert rig.drive.mode == Mode.NO_MODE
    elif asked == math.inf:
        assert rig.run(procedure) == 0.1
        stands(rig)
    else:
        with pytest.raises(drive.LimitReachedError, match=r"is too fast: 0.5\d* per second; the limit is 0.5, by"):
            rig.run(procedure)
        stands(rig)


def test_a_limit_of_the_drive_counts_too() -> None:
    rig = rig_of()
    rig.node.values.store[objects.MAX_PROFILE_VELOCITY] = 20_000
    assert rig.run(drive.apply_torque(rig.axis, 0.1, SECOND)) == 0.1  # the drive keeps its limit by itself
    stands(rig)


@pytest.mark.thorough(2)
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("torque", [0.1, -0.1])
def test_a_limit_of_the_position_stops_it(torque: float, direction: int) -> None:
    rig = rig_of(max_speed=10.0, min_position=-0.3, max_position=0.3, direction=direction)
    with pytest.raises(drive.LimitReachedError, match=r"is beyond its limit: .*settings \((max|min)_position\)"):
        rig.run(drive.apply_torque(rig.axis, torque, 5 * SECOND))
    stands(rig)
    position = rig.run(drive.read_position(rig.axis))
    assert math.copysign(1.0, position) == math.copysign(1.0, torque)
    assert 0.3 < abs(position) < 0.3 + 0.4  # the way of a look, and of the ramp


def test_without_an_actual_velocity_the_speed_is_taken_from_positions() -> None:
    rig = rig_of(max_speed=0.5)
    described = rig.node.dictionary.objects.items()
    rig.remote.dictionary = ObjectDictionary([each for index, each in described if index != 0x606C])
    with pytest.raises(drive.LimitReachedError, match="is too fast: "):
        rig.run(drive.apply_torque(rig.axis, 0.1, 5 * SECOND))
    stands(rig)


@pytest.mark.thorough(4)
@pytest.mark.parametrize("coasts", [False, True])
@pytest.mark.parametrize("after", [0, 50, 200, 400])
def test_a_cancel_stops_it(after: int, coasts: bool) -> None:
    """A drive that only takes its torque away by bit 8, and has no friction, gets a quick stop."""
    mechanics = replace(JOINT, coulomb_friction=0.0, viscous_friction=0.0) if coasts else JOINT
    rig = rig_of(mechanics, coasts=coasts, max_speed=10.0)
    request = rig.master.run(drive.apply_torque(rig.axis, 0.05, 10 * SECOND), rig.bus.now)
    rig.bus.run(after * MILLISECOND)
    rig.master.cancel(request, rig.bus.now)
    assert isinstance(rig.outcome(request), ProcedureCancelled)
    stands(rig)
    if coasts and after >= 200:
        assert rig.drive.state is State.SWITCH_ON_DISABLED
        assert rig.axis.controlword == 0x02


@pytest.mark.parametrize("after", range(8_000, 11_000, 200))
def test_a_cancel_while_it_gets_power_lets_no_load_fall(after: int) -> None:
    """after: us; it has power from 9,700 on. With 0 of torque, a weight falls as soon as the brake is open."""
    rig = rig_of(replace(JOINT, load=2.0), max_speed=50.0)
    request = rig.master.run(drive.apply_torque(rig.axis, 0.25, 10 * SECOND), rig.bus.now)
    rig.bus.run(after * MICROSECOND)
    rig.master.cancel(request, rig.bus.now)
    assert isinstance(rig.outcome(request), ProcedureCancelled)
    rig.bus.run(SECOND)
    assert rig.drive.state is not State.OPERATION_ENABLED or rig.axis.controlword & ControlBit.HALT
    assert abs(velocity_of(rig)) < 10


def test_a_torque_that_0x6071_cannot_hold_is_refused_before_the_drive_has_power() -> None:
    rig = rig_of(replace(JOINT, load=2.0), max_speed=50.0)
    rig.node.values.store[objects.MAX_TORQUE] = 65_535
    with pytest.raises(ValueRangeError, match="0x6071"):
        rig.run(drive.apply_torque(rig.axis, 40.0, SECOND))
    assert rig.drive.state is State.SWITCH_ON_DISABLED
    assert rig.drive.mode == Mode.NO_MODE


def test_a_torque_that_ends_in_time_on_a_drive_that_coasts_leaves_it_standing() -> None:
    rig = rig_of(replace(JOINT, coulomb_friction=0.0, viscous_friction=0.0), coasts=True, max_speed=10.0)
    assert rig.run(drive.apply_torque(rig.axis, 0.05, 300 * MILLISECOND)) == 0.05
    stands(rig)


def test_a_load_that_the_drive_holds_does_not_fall() -> None:
    """Enabled and holding 2 N·m of a weight, it begins with that torque."""
    rig = rig_of(replace(JOINT, load=2.0), max_speed=2.0)
    rig.run(drive.select_motionless_mode(rig.axis))
    rig.run(drive.enable(rig.axis))
    rig.bus.run(SECOND)
    lowest = 0.0

    def look(event: object) -> None:
        nonlocal lowest
        rig.drive.refresh(rig.bus.now)
        lowest = min(lowest, rig.drive._servo.position)

    rig.bus.on_event = look
    rig.run(drive.apply_torque(rig.axis, 0.25, 300 * MILLISECOND, slope=1.0))
    stands(rig)
    assert lowest > -100  # counts
    requests = [frame.data for _, frame in rig.bus.sent if frame.can_id == 0x605]
    held, target, end = (int.from_bytes(data[4:6], "little") for data in requests if data[:4] == b"\x2b\x71\x60\x00")
    assert (held, target, end) == (pytest.approx(200, abs=35), 250, 0)  # of 10 N·m; friction takes its part


@pytest.mark.parametrize(
    ("torque", "slope", "words"),
    [
        (0.0004, None, "0x6071 counts thousandths"),
        (3.5, None, "0x6072 allows 3 of the rated torque"),
        (0.1, 0.0001, "0x6087 counts thousandths"),
        (40.0, None, "0x6072 allows"),
    ],
)
def test_what_the_wire_cannot_hold_is_refused_and_nothing_moves(torque: float, slope: float | None, words: str) -> None:
    rig = rig_of(max_speed=2.0)
    with pytest.raises(ProcedureError, match=words):
        rig.run(drive.apply_torque(rig.axis, torque, SECOND, slope=slope))
    assert rig.drive.state is State.SWITCH_ON_DISABLED
    assert velocity_of(rig) == 0


@pytest.mark.parametrize(
    ("duration", "max_speed", "name"),
    [(-1, 2.0, "duration"), (SECOND, 0.0, "max_speed"), (SECOND, -1.0, "max_speed"), (SECOND, math.nan, "max_speed")],
)
def test_limits_that_limit_nothing_are_refused(duration: int, max_speed: float, name: str) -> None:
    rig = rig_of(max_speed=2.0)
    with pytest.raises(LocalProtocolError, match=f"{name} must"):
        rig.run(drive.apply_torque(rig.axis, 0.1, duration, max_speed=max_speed))
    assert rig.drive.state is State.SWITCH_ON_DISABLED


def test_a_fault_and_another_mode_end_it() -> None:
    rig = rig_of(max_speed=10.0)
    request = rig.master.run(drive.apply_torque(rig.axis, 0.05, 10 * SECOND), rig.bus.now)
    rig.bus.run(300 * MILLISECOND)
    rig.node.raise_fault(0x2310, rig.bus.now)
    assert isinstance(rig.outcome(request).error, drive.DriveInFaultError)  # type: ignore[union-attr]

    rig = rig_of(max_speed=10.0)
    request = rig.master.run(drive.apply_torque(rig.axis, 0.05, 10 * SECOND), rig.bus.now)
    rig.bus.run(300 * MILLISECOND)
    rig.node.values.store[objects.MODES_OF_OPERATION] = Mode.PROFILE_VELOCITY
    rig.drive.written(0x6060, 0, rig.bus.now)
    assert isinstance(rig.outcome(request).error, drive.ModeLostError)  # type: ignore[union-attr]
    assert abs(velocity_of(rig)) < 10


def test_a_drive_that_has_lost_its_reference_is_not_pushed_within_limits_that_mean_nothing() -> None:
    rig = rig_of(max_speed=2.0, max_position=1.0)
    rig.axis.is_homed = True
    rig.axis.is_homed = False
    with pytest.raises(drive.ReferenceLostError):
        rig.run(drive.apply_torque(rig.axis, 0.05, SECOND))


def test_a_drive_without_the_mode() -> None:
    rig = rig_of(max_speed=2.0)
    rig.node.values.store[objects.SUPPORTED_DRIVE_MODES] = 0xE5
    with pytest.raises(drive.ModeUnsupportedError, match="torque"):
        rig.run(drive.apply_torque(rig.axis, 0.05, SECOND))
