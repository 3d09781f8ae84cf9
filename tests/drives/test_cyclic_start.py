"""Cyclic synchronous velocity and torque (and offsets in csp) from the master's side: start, set-points, the watch on bounds."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import pytest

from canopen_proto.dictionary import Direction, ObjectDictionary, PdoDescription
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.bounds import MotionBounds
from canopen_proto.drives.axis.following import Following, FollowingLost
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, RequestId
from canopen_proto.pdo.configure import define_pdo
from canopen_proto.procedures.objects import write
from canopen_proto.procedures.runner import ProcedureCancelled
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.drives.rig import CYCLE, Rig

JOINT = Mechanics()
CSP, CSV, CST = Mode.CYCLIC_SYNCHRONOUS_POSITION, Mode.CYCLIC_SYNCHRONOUS_VELOCITY, Mode.CYCLIC_SYNCHRONOUS_TORQUE
COMMANDS = {CSP: ("0x6040", "0x607A", "0x60B2"), CSV: ("0x6040", "0x60FF", "0x60B2"), CST: ("0x6040", "0x6071", "0x60B2")}
FEEDBACK = ("0x6041", "0x6061", "0x6064")
FAST = ("0x606C", "0x6077")
CYCLIC = dict.fromkeys(
    (
        objects.STATUSWORD,
        objects.MODES_OF_OPERATION_DISPLAY,
        objects.POSITION_ACTUAL_VALUE,
        objects.VELOCITY_ACTUAL_VALUE,
    ),
    1,
)


def rig_of(mode: Mode, mechanics: Mechanics = JOINT, dictionary: ObjectDictionary | None = None, **settings: Any) -> Rig:
    """A joint with a mass at 0, with the set-points of a mode and what it shows in PDOs at each SYNC. settings: of its axis."""
    track = Track(-math.inf, math.inf)
    device = DriveSettings(position=0, mechanics=mechanics, track=track)
    rig = Rig(Shape.STANDARD, pdos=False, drive=device, dictionary=dictionary)
    rig.axis.settings = replace(rig.axis.settings, **settings)
    named = rig.remote.dictionary.variable
    for name, base, direction, number, keys in (
        ("command", 0x200, Direction.RPDO, 1, COMMANDS[mode]),
        ("feedback", 0x180, Direction.TPDO, 1, FEEDBACK),
        ("fast", 0x280, Direction.TPDO, 2, FAST),
    ):
        rig.run(define_pdo(rig.remote, PdoDescription(name, base, direction, number, tuple(map(named, keys)))))
    rig.start_sync()
    return rig


def velocity_of(rig: Rig) -> float:
    rig.drive.refresh(rig.bus.now)
    return rig.drive._servo.velocity


def watched(rig: Rig, mode: Mode, bounds: MotionBounds) -> Following:
    following = Following(rig.axis)
    following.begin_with_bounds(bounds, mode, cyclic=CYCLIC)
    assert following.unsent == set()
    return following


def cause_of(rig: Rig) -> str:
    (lost,) = rig.bus.take_events(FollowingLost)
    return lost.cause


# ---- velocity ----


def test_velocities_are_followed_from_standstill() -> None:
    rig = rig_of(CSV, max_speed=2.0)
    bounds = rig.run(drive.bounds_of(rig.axis))
    assert rig.run(drive.start_cyclic_velocity(rig.axis, CYCLE)) == 0
    watched(rig, CSV, bounds)
    for step in range(100):
        rig.axis.set_points.set_velocity(min(1.0, step / 50))
        rig.bus.run(CYCLE)
    assert rig.axis.velocity == pytest.approx(1.0, rel=0.01)
    rig.axis.set_points.set_velocity(0.0)  # it stands: no further set-point is needed
    rig.bus.run(30 * CYCLE)
    assert not rig.bus.take_events(FollowingLost)
    assert abs(velocity_of(rig)) < 50


def test_a_drive_that_runs_is_halted_first_and_its_old_target_and_offset_are_gone() -> None:
    rig = rig_of(CSV)
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_VELOCITY))
    rig.run(drive.enable(rig.axis))
    rig.run(write(rig.remote, "0x60B1", 5_000))
    rig.run(write(rig.remote, "0x60FF", 20_000))
    rig.bus.run(SECOND)
    assert velocity_of(rig) == pytest.approx(20_000, rel=0.05)
    rig.run(drive.start_cyclic_velocity(rig.axis, CYCLE))
    for _ in range(10):
        rig.bus.run(CYCLE)
        assert abs(velocity_of(rig)) < 50
    store = rig.node.values.store
    assert (store[objects.TARGET_VELOCITY], store[objects.VELOCITY_OFFSET], store[objects.TORQUE_OFFSET]) == (0, 0, 0)


def test_without_a_velocity_unit_nothing_is_commanded() -> None:
    """0x60A9 names a unit that nobody knows here."""
    dictionary = drive_dictionary().with_objects([standard_object(0x60A9, 0x0012_0300)])
    rig = rig_of(CSV, dictionary=dictionary)
    with pytest.raises(drive.DriveError, match="does not tell its velocity unit"):
        rig.run(drive.start_cyclic_velocity(rig.axis, CYCLE))
    assert rig.drive.state is State.SWITCH_ON_DISABLED
    rig.axis.settings = replace(rig.axis.settings, velocity_unit=100.0)
    rig.run(drive.start_cyclic_velocity(rig.axis, CYCLE))


@pytest.mark.parametrize(
    ("settings", "velocity", "words"),
    [
        ({"max_speed": 0.5}, 1.0, r"is too fast: 0\.[5-9]\d* per second; the limit is 0.5, by the settings \(max_speed\)"),
        (
            {"max_speed": 5.0, "max_position": 0.2},
            0.5,
            r"is beyond its limit: it is at 0.2\d*; the limit is 0.2, by the settings",
        ),
        ({"max_speed": 5.0, "min_position": -0.2}, -0.5, r"is beyond its limit: it is at -0.2\d*; the limit is -0.2, by"),
    ],
)
@pytest.mark.parametrize("mode", [CSV, CST])
def test_bounds_that_are_left_are_told_and_a_halt_then_stops_it(
    mode: Mode, settings: dict[str, float], velocity: float, words: str
) -> None:
    rig = rig_of(mode, **settings)
    bounds = rig.run(drive.bounds_of(rig.axis))
    start = {CSV: drive.start_cyclic_velocity, CST: drive.start_cyclic_torque}[mode]
    rig.run(start(rig.axis, CYCLE))
    following = watched(rig, mode, bounds)
    for _ in range(200):
        if mode == CSV:
            rig.axis.set_points.set_velocity(velocity)
        else:
            rig.axis.set_points.set_torque(velocity / 5)
        rig.bus.run(CYCLE)
        if not following.is_on:
            break
    assert re.match(words, cause_of(rig))
    rig.run(drive.halt(rig.axis))
    assert abs(velocity_of(rig)) < 50


@pytest.mark.parametrize("mode", [CSV, CST])
def test_what_else_ends_it(mode: Mode) -> None:
    def following(rig: Rig) -> None:
        bounds = rig.run(drive.bounds_of(rig.axis))
        rig.run({CSV: drive.start_cyclic_velocity, CST: drive.start_cyclic_torque}[mode](rig.axis, CYCLE))
        watched(rig, mode, bounds)
        rig.bus.run(5 * CYCLE)

    rig = rig_of(mode, max_speed=5.0)
    following(rig)
    rig.node.raise_fault(0x2310, rig.bus.now)
    rig.bus.run(3 * CYCLE)
    assert cause_of(rig).startswith("left operation enabled by itself")

    rig = rig_of(mode, max_speed=5.0)
    following(rig)
    rig.run(write(rig.remote, "0x6060", Mode.PROFILE_VELOCITY))
    rig.bus.run(3 * CYCLE)
    assert cause_of(rig).startswith("changed its mode of operation")

    rig = rig_of(mode, max_speed=5.0)
    following(rig)
    rig.bus.detach(rig.device)
    rig.bus.run(10 * CYCLE)
    assert cause_of(rig).startswith("is silent")


# ---- torque ----


def test_a_drive_that_holds_a_load_goes_on_holding_it() -> None:
    rig = rig_of(CST, replace(JOINT, load=2.0), max_speed=2.0)
    rig.run(drive.select_motionless_mode(rig.axis))
    rig.run(drive.enable(rig.axis))
    rig.bus.run(SECOND)
    position = rig.run(drive.read_position(rig.axis))
    held = rig.run(drive.start_cyclic_torque(rig.axis, CYCLE))
    assert held == pytest.approx(0.2, abs=0.035)  # 2 of 10 N·m; friction takes its part
    rig.bus.run(50 * CYCLE)
    assert rig.axis.position == pytest.approx(position, abs=0.01)
    assert rig.axis.set_points.set_torque(0.3) == 0.3
    rig.bus.run(20 * CYCLE)
    assert rig.axis.position > position + 0.01
    rig.run(drive.halt(rig.axis))


def test_the_torque_at_the_start_can_be_given() -> None:
    rig = rig_of(CST, max_speed=2.0)
    assert rig.run(drive.start_cyclic_torque(rig.axis, CYCLE, torque=0.0104)) == 0.01
    assert rig.node.values.store[objects.TARGET_TORQUE] == 10


@pytest.mark.parametrize("after", range(0, 24, 4))
def test_a_start_that_is_cancelled_halts(after: int) -> None:
    rig = rig_of(CST, max_speed=2.0)
    request = rig.master.run(drive.start_cyclic_torque(rig.axis, CYCLE, torque=0.1), rig.bus.now)
    rig.bus.run(after * MILLISECOND)
    rig.master.cancel(request, rig.bus.now)
    assert isinstance(rig.outcome(request), ProcedureCancelled)
    rig.bus.run(SECOND)
    assert abs(velocity_of(rig)) < 50


def test_set_points_must_be_carried() -> None:
    rig = rig_of(CSV)
    with pytest.raises(drive.DriveError, match="carries 0x6071:00"):
        rig.run(drive.start_cyclic_torque(rig.axis, CYCLE))
    rig = rig_of(CST)
    with pytest.raises(drive.DriveError, match="carries 0x60FF:00"):
        rig.run(drive.start_cyclic_velocity(rig.axis, CYCLE))
    assert rig.drive.state is State.SWITCH_ON_DISABLED


def test_a_drive_that_does_not_show_that_it_follows() -> None:
    """Without SYNC the simulated drive leaves bit 12 at 0, as others always do."""
    rig = rig_of(CSP)
    rig.run(drive.start_cyclic_position(rig.axis, CYCLE))
    rig.bus.run(5 * CYCLE)
    rig.sync.stop()
    rig.bus.run(SECOND)
    assert not rig.run(drive.read_statusword(rig.axis)) & 0x1000
    with pytest.raises(drive.DriveTimeoutError, match=r"follows command \(bit 12\)"):
        rig.run(drive.start_cyclic_position(rig.axis, CYCLE))
    rig.axis.settings = replace(rig.axis.settings, shows_following=False)
    rig.run(drive.start_cyclic_position(rig.axis, CYCLE))


# ---- the watch that halts it ----


def kept(rig: Rig, mode: Mode) -> RequestId:
    """A drive that follows, and is kept within its bounds."""
    bounds = rig.run(drive.bounds_of(rig.axis))
    rig.run({CSV: drive.start_cyclic_velocity, CST: drive.start_cyclic_torque}[mode](rig.axis, CYCLE))
    return rig.master.run(drive.watch_bounds(Following(rig.axis), bounds, mode, cyclic=CYCLIC), rig.bus.now)


def give(rig: Rig, mode: Mode, cycles: int) -> None:
    for _ in range(cycles):
        if any(isinstance(event, FollowingLost) for event in rig.bus.events):
            return
        if mode == CSV:
            rig.axis.set_points.set_velocity(0.5)
        else:
            rig.axis.set_points.set_torque(0.1)
        rig.bus.run(CYCLE)


def stands_for_good(rig: Rig, mode: Mode) -> None:
    """It is halted, and no set-point is left for the RPDO."""
    assert abs(velocity_of(rig)) < 50
    assert rig.axis.controlword & 0x100 or rig.drive.state is State.SWITCH_ON_DISABLED
    key = {CSV: objects.TARGET_VELOCITY, CST: objects.TARGET_TORQUE}[mode]
    rig.bus.run(2 * CYCLE)
    assert rig.node.values.store[key] == 0


@pytest.mark.parametrize("mode", [CSV, CST])
def test_bounds_that_are_left_halt_it(mode: Mode) -> None:
    rig = rig_of(mode, max_speed=2.0, max_position=0.2)
    request = kept(rig, mode)
    give(rig, mode, 120)
    ended = rig.outcome(request)
    assert isinstance(ended.error, drive.OutOfBoundsError)  # type: ignore[union-attr]
    assert "is beyond its limit" in str(ended.error)  # type: ignore[union-attr]
    stands_for_good(rig, mode)


@pytest.mark.parametrize("after", range(0, 3_600, 200))
def test_a_cancel_while_it_gets_power_for_torques_lets_no_load_fall(after: int) -> None:
    """after: us; the start takes 3.8 ms."""
    device = DriveSettings(position=0, mechanics=replace(JOINT, load=2.0), track=Track(-math.inf, math.inf))
    rig = Rig(Shape.STANDARD, pdos=False, drive=device)
    request = rig.master.run(drive.start_cyclic_torque(rig.axis, CYCLE, sends_itself=True), rig.bus.now)
    rig.bus.run(after * MICROSECOND)
    rig.master.cancel(request, rig.bus.now)
    assert isinstance(rig.outcome(request), ProcedureCancelled)
    rig.bus.run(SECOND)
    assert rig.drive.state is not State.OPERATION_ENABLED or rig.axis.controlword & 0x100
    assert abs(velocity_of(rig)) < 10


@pytest.mark.thorough(2)
@pytest.mark.parametrize("mode", [CSV, CST])
def test_a_drive_that_ignores_the_halt_is_stopped_if_the_watch_is_cancelled(mode: Mode) -> None:
    """By its set-point in csv, by a quick stop in cst."""
    rig = rig_of(mode, max_speed=5.0)
    rig.ignore_halts()
    request = kept(rig, mode)
    give(rig, mode, 30)
    assert abs(velocity_of(rig)) > 1_000
    rig.master.cancel(request, rig.bus.now)
    assert isinstance(rig.outcome(request), ProcedureCancelled)
    stands_for_good(rig, mode)


@pytest.mark.parametrize("mode", [CSV, CST])
def test_set_points_that_stay_away_halt_it(mode: Mode) -> None:
    """The RPDO would repeat the last one for ever."""
    rig = rig_of(mode, max_speed=5.0)
    request = kept(rig, mode)
    give(rig, mode, 30)
    moved = rig.bus.now
    ended = rig.outcome(request)
    assert "got no new set-point for 11 SYNCs" in str(ended.error)  # type: ignore[union-attr]
    assert rig.bus.now - moved < SECOND
    stands_for_good(rig, mode)


@pytest.mark.parametrize("mode", [CSV, CST])
def test_a_cancel_halts_it(mode: Mode) -> None:
    rig = rig_of(mode, max_speed=5.0)
    request = kept(rig, mode)
    give(rig, mode, 30)
    rig.master.cancel(request, rig.bus.now)
    assert isinstance(rig.outcome(request), ProcedureCancelled)
    stands_for_good(rig, mode)


# ---- offsets ----


def test_feed_forward_of_torque_takes_the_load_from_the_loop() -> None:
    """In csp: at the moment when 2 N·m of a load are known to the master, its offset carries them."""
    rig = rig_of(CSP, replace(JOINT, load=2.0))
    rig.run(write(rig.remote, "0x60B2", 150))
    rig.run(drive.start_cyclic_position(rig.axis, CYCLE))
    assert rig.node.values.store[objects.TORQUE_OFFSET] == 0
    rig.axis.set_points.set_offsets(torque=0.2)
    rig.bus.run(100 * CYCLE)
    assert rig.node.values.store[objects.TORQUE_OFFSET] == 200
    assert rig.axis.torque == pytest.approx(0.2, abs=0.035)
    assert abs(velocity_of(rig)) < 50
