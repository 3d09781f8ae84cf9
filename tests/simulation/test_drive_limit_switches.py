"""Limit switches of the simulated drive, in every mode: it brakes, shows bit 11, goes no further, and comes away when told to."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import NEVER
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.simulation.drive_bench import Bench

INTERNAL_LIMIT, REACHED, FOLLOWS = 11, 10, 12
LIMIT = 20_000
TRACK = Track(negative_limit=-LIMIT, positive_limit=LIMIT)
SPEED = 40_000
STEP, QUICK_STOP = 0.010, 400_000
FURTHEST = LIMIT + SPEED * STEP + SPEED**2 / (2 * QUICK_STOP) + 0.005 * SPEED
"""One look of the drive too late, then the quick stop ramp; plus the lag."""

Move = Callable[[Bench, int], None]
"""Makes the axis go in a direction, for ever or far beyond the limit."""


def pp(bench: Bench, direction: int) -> None:
    bench.write(0x607A, direction * 100_000)
    bench.control(0x2F, 0x3F)


def pv(bench: Bench, direction: int) -> None:
    bench.write(0x60FF, direction * SPEED)


def vl(bench: Bench, direction: int) -> None:
    bench.control(0x7F)
    bench.put(0x6042, direction * 30_000)


def ip(bench: Bench, direction: int) -> None:
    bench.control(0x0F, 0x1F)
    _set_points(bench, 0x60C1, 1, direction)


def csp(bench: Bench, direction: int) -> None:
    _set_points(bench, 0x607A, 0, direction)


def _set_points(bench: Bench, index: int, subindex: int, direction: int) -> None:
    """75 set-points over 25 800, 10 ms apart, speeding up from where the axis stands."""
    speed, target = 0.0, float(bench.position)
    for _ in range(75):
        target += direction * speed * 0.01
        bench.put(index, round(target), subindex)
        bench.sync()
        speed = min(SPEED, speed + 2_000)


def csv(bench: Bench, direction: int) -> None:
    _targets(bench, 0x60FF, direction * SPEED)


def tq(bench: Bench, direction: int) -> None:
    bench.write(0x6071, direction * 100)


def cst(bench: Bench, direction: int) -> None:
    _targets(bench, 0x6071, direction * 100)


def _targets(bench: Bench, index: int, target: int) -> None:
    """A target for 75 SYNCs; 0 first, as a drive that has lost its SYNC wants it."""
    for each in (0, target):
        bench.put(index, each)
        for _ in range(75 if each else 2):
            bench.sync()


MODES: dict[int, Move] = {1: pp, 2: vl, 3: pv, 7: ip, 8: csp, 9: csv}
TORQUE_MODES: dict[int, Move] = {4: tq, 10: cst}


def enabled(mode: int, position: float = 0, *, shape: Shape = Shape.STANDARD) -> Bench:
    shape = Shape.SCHUNK_POWERBALL if mode == 2 else shape
    bench = Bench(DriveSettings(shape=shape, position=position, track=TRACK))
    bench.preset(0x6081, SPEED)
    bench.preset(0x60C2, 10, 1)
    bench.enable(mode)
    return bench


@pytest.mark.parametrize("direction", [-1, 1])
@pytest.mark.parametrize("mode", MODES)
def test_a_limit_switch_stops_the_axis_in_every_mode(mode: int, direction: int) -> None:
    bench, move = enabled(mode), MODES[mode]
    move(bench, direction)
    bench.run(3_000)
    place = bench.position
    assert LIMIT <= place * direction <= FURTHEST
    assert bench.read(0x606C) == 0
    assert bench.state is State.OPERATION_ENABLED  # it can be told to go away
    assert bench.has(INTERNAL_LIMIT)
    assert not bench.has(REACHED) or mode == 7  # in ip, bit 10 says that it stands where it was left
    assert bench.read(0x60FD) & 0b11 == (0b10 if direction > 0 else 0b01)
    move(bench, direction)  # again: no further
    bench.run(500)
    assert bench.position == place
    move(bench, -direction)  # away: at once, and off the switch
    bench.run(300)
    assert bench.position * direction < LIMIT
    assert bench.read(0x60FD) & 0b11 == 0
    assert not bench.has(INTERNAL_LIMIT)


@pytest.mark.parametrize("mode", [7, 8])
def test_a_mode_that_follows_set_points_stops_following(mode: int) -> None:
    bench, move = enabled(mode), MODES[mode]
    assert bench.control(0x1F if mode == 7 else 0x0F) is State.OPERATION_ENABLED
    bench.sync()
    assert bench.has(FOLLOWS)
    move(bench, 1)
    assert not bench.has(FOLLOWS)
    place = bench.position
    for _ in range(5):  # set-points that lead away count only once it follows again
        bench.put(0x60C1 if mode == 7 else 0x607A, 0, 1 if mode == 7 else 0)
        bench.sync()
    assert bench.position == place


def test_an_axis_on_the_switch_at_power_on_goes_one_way_only() -> None:
    for mode in (1, 3):
        bench, move = enabled(mode, LIMIT + 500), MODES[mode]
        assert not bench.has(INTERNAL_LIMIT)  # nothing was asked of it
        move(bench, 1)
        bench.run(1_000)
        assert bench.position == LIMIT + 500
        assert bench.has(INTERNAL_LIMIT)
        move(bench, -1)
        bench.run(200)
        assert bench.position < LIMIT + 500


def test_an_axis_that_stands_at_the_switch_sleeps() -> None:
    bench = enabled(3)
    pv(bench, 1)
    bench.run(3_000)
    bench.write(0x60FF, 0)
    bench.run(1_000)
    assert bench.drive.deadline == NEVER


def test_a_harder_brake_is_not_softened_by_the_switch() -> None:
    bench = enabled(3)
    bench.write(0x605A, 3)  # quick stop as hard as it can: 60C6h
    bench.write(0x60C6, 4_000_000)
    pv(bench, 1)
    while bench.position < LIMIT - 200:
        bench.run(1)
    bench.control(0x02)
    bench.run(200)
    assert bench.state is State.SWITCH_ON_DISABLED
    assert LIMIT - 200 < bench.position < LIMIT + 300


@pytest.mark.thorough(3)
@pytest.mark.parametrize("direction", [-1, 1])
@pytest.mark.parametrize("mode", [1, 3, 4, 7, 8, 9, 10])
def test_a_mass_is_stopped_as_well(mode: int, direction: int) -> None:
    """With mechanics: the torque that drives the axis on is taken back, and it brakes."""
    move = {**MODES, **TORQUE_MODES}[mode]
    bench = Bench(DriveSettings(position=0, track=TRACK, mechanics=Mechanics()))
    bench.preset(0x6081, SPEED)
    bench.preset(0x60C2, 10, 1)
    bench.preset(0x607F, SPEED)
    bench.enable(mode)
    move(bench, direction)
    bench.run(3_000)
    place = bench.position
    assert LIMIT <= place * direction <= FURTHEST + 1_000
    assert abs(bench.read(0x606C)) < 100
    assert bench.has(INTERNAL_LIMIT)
    move(bench, -direction)
    bench.run(1_000)
    assert bench.position * direction < LIMIT


def test_a_drive_whose_track_is_not_known_is_not_stopped() -> None:
    bench = Bench(DriveSettings(position=0, track=TRACK, stops_at_switches=False))
    bench.enable(3)
    pv(bench, 1)
    bench.run(3_000)
    assert bench.position > 2 * LIMIT
    assert not bench.has(INTERNAL_LIMIT)
