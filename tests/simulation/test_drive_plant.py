"""The simulated drive with a mass behind it: torque, torque limits, power, and time on its grid."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import NEVER, SECOND
from canopen_proto.simulation.drive.drive import FOLLOWING_ERROR
from canopen_proto.simulation.drive.events import DriveFault
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings
from tests.simulation.drive_bench import Bench

JOINT = Mechanics()
UNITS = JOINT.units_per_radian
RATED = 10.0  # N·m, of 0x6076


def bench_of(mechanics: Mechanics = JOINT, mode: int = 1) -> Bench:
    """An enabled drive with a mass, at position 0."""
    bench = Bench(DriveSettings(position=0, mechanics=mechanics))
    bench.enable(mode)
    return bench


def go(bench: Bench, target: int, acceleration: int = 100_000) -> None:
    """Start a move of profile position."""
    bench.write(0x6083, acceleration)
    bench.write(0x6084, acceleration)
    bench.write(0x607A, target)
    bench.control(0x0F, 0x1F)


def test_a_move_ends_at_its_target_and_then_costs_nothing() -> None:
    bench = bench_of()
    go(bench, 40_000)
    bench.run(3_000)
    assert (bench.position, bench.read(0x606C), bench.has(10)) == (40_000, 0, True)
    assert bench.drive.deadline == NEVER


def test_the_result_does_not_depend_on_when_it_is_looked_at() -> None:
    def path(seed: int) -> list[tuple[int, int, int]]:
        chance, seen = random.Random(seed), []
        bench = bench_of(replace(JOINT, load=2.0))
        go(bench, 9_000)
        for _ in range(20):
            until = bench.now + SECOND // 30  # not on the grid of the steps
            while seed and bench.now < until:
                bench.now = min(until, bench.now + chance.randrange(1, 3_000_000))
                bench.drive.refresh(bench.now)
            bench.run((until - bench.now) / 1e6)
            seen.append((bench.position, bench.read(0x606C), bench.read(0x6077)))
        return seen

    assert path(0) == path(1) == path(2)


def test_torque_is_that_of_inertia_friction_and_load() -> None:
    mechanics = replace(JOINT, load=1.0)
    bench = bench_of(mechanics)
    bench.run(500)
    go(bench, 10**6)
    bench.run(150)  # at 15,000 of 20,000 units/s
    speed, acceleration = bench.read(0x606C) / UNITS, 100_000 / UNITS
    friction = mechanics.coulomb_friction + mechanics.viscous_friction * speed
    expected = mechanics.inertia * acceleration + friction + mechanics.load
    assert bench.read(0x6077) == pytest.approx(expected / RATED * 1000, abs=2)
    assert bench.read(0x6074) == bench.read(0x6078) == pytest.approx(bench.read(0x6077), abs=1)
    bench.run(1_000)
    friction = mechanics.coulomb_friction + mechanics.viscous_friction * 20_000 / UNITS
    assert bench.read(0x6077) == pytest.approx((friction + mechanics.load) / RATED * 1000, abs=1)


@pytest.mark.parametrize("limit", [0x6072, 0x6073, 0x60E0])
def test_a_torque_limit_is_obeyed_shown_and_ends_in_a_following_error(limit: int) -> None:
    bench = bench_of()
    bench.write(limit, 90)  # 0.9 N·m: 0.6 N·m beyond Coulomb friction
    bench.write(0x6065, 1_000)
    go(bench, 10**6, 400_000)
    bench.run(100)
    assert bench.has(11)
    assert bench.read(0x6074) == 90
    assert bench.read(0x606C) < (0.9 - 0.3) / JOINT.inertia * 0.1 * UNITS
    bench.run(60)
    assert bench.has(13)
    bench.run(100)
    assert [fault.error_code for fault in bench.reported(DriveFault)] == [FOLLOWING_ERROR]


def test_the_limit_of_one_direction_leaves_the_other_alone() -> None:
    bench = bench_of()
    bench.write(0x60E1, 0)
    go(bench, 10_000)
    bench.run(100)
    assert not bench.has(11)
    bench.write(0x607A, -10_000)
    bench.control(0x0F, 0x3F)
    bench.run(100)
    assert bench.has(11)
    assert bench.read(0x6074) == 0


def test_a_limit_that_is_written_while_it_moves_acts_from_then_on() -> None:
    bench = bench_of()
    go(bench, 10**6)
    bench.run(1_003.1)
    assert not bench.has(11)
    bench.write(0x6072, 40)  # less than the friction
    bench.run(1)
    assert bench.has(11)
    assert bench.read(0x6074) == 40


def test_without_power_the_brake_stops_the_mass() -> None:
    bench = bench_of()
    go(bench, 10**6)
    bench.run(1_000)
    start, speed = bench.position, bench.read(0x606C)
    assert bench.control(0x00) is State.SWITCH_ON_DISABLED
    assert bench.read(0x6077) == 0
    assert bench.read(0x606C) == speed
    bench.run(500)
    deceleration = (JOINT.brake_torque + JOINT.coulomb_friction) / JOINT.inertia * UNITS
    assert bench.position - start == pytest.approx(speed**2 / 2 / deceleration, rel=0.05)
    assert bench.read(0x606C) == bench.read(0x60F4) == 0
    assert bench.drive.deadline == NEVER


def test_enabled_while_it_still_runs_it_brakes_by_the_quick_stop_ramp() -> None:
    bench = bench_of(replace(JOINT, brake_torque=0.0, coulomb_friction=0.0, viscous_friction=0.0))
    go(bench, 10**6)
    bench.run(1_000)
    bench.control(0x00)
    bench.run(100)
    start = bench.position
    assert bench.read(0x606C) == 20_000
    bench.control(0x06, 0x07, 0x0F)
    bench.run(200)
    assert bench.position - start == pytest.approx(20_000**2 / 2 / 400_000, rel=0.02)
    assert bench.read(0x606C) == 0


def test_a_load_is_held_while_enabled_and_by_the_brake_afterwards() -> None:
    bench = bench_of(replace(JOINT, load=5.0))
    bench.run(1_000)
    assert (bench.position, bench.read(0x606C)) == (0, 0)
    assert bench.read(0x6077) == pytest.approx(500, abs=31)  # friction holds a part
    bench.control(0x00)
    bench.run(1_000)
    assert abs(bench.position) <= 1
    assert bench.read(0x6077) == 0


def test_a_blocked_axis_gets_a_following_error_and_its_full_torque() -> None:
    bench = bench_of()
    bench.drive.block(True, bench.now)
    bench.write(0x6065, 100)
    go(bench, 50_000)
    bench.run(60)
    assert bench.position == 0
    assert bench.read(0x6077) > 1_000
    bench.run(200)
    assert [fault.error_code for fault in bench.reported(DriveFault)] == [FOLLOWING_ERROR]


def test_a_quick_stop_ends_when_the_mass_stands() -> None:
    bench = bench_of()
    go(bench, 10**6)
    bench.run(1_000)
    bench.control(0x02)
    while bench.state is State.QUICK_STOP_ACTIVE:
        bench.run(1)
    assert abs(bench.read(0x606C)) <= 1


def test_a_mass_that_the_torque_cannot_stop_is_left_to_the_brake() -> None:
    bench = bench_of(replace(JOINT, coulomb_friction=0.0, viscous_friction=0.0))
    go(bench, 10**6)
    bench.run(1_000)
    bench.write(0x6072, 0)
    bench.write(0x6065, 2**32 - 1)
    bench.control(0x02)
    bench.run(1_000)
    assert bench.state is State.QUICK_STOP_ACTIVE
    assert bench.read(0x606C) == 20_000
    bench.run(200)
    assert bench.state is State.SWITCH_ON_DISABLED
    assert bench.read(0x606C) == 0


@pytest.mark.thorough(4)
@pytest.mark.parametrize("method", [17, 18, 19, 21, 33, 34])
def test_homing_finds_the_same_place_with_a_mass(method: int) -> None:
    found = []
    for mechanics in (None, JOINT):
        bench = Bench(DriveSettings(mechanics=mechanics))
        bench.write(0x6098, method)
        bench.enable(6)
        bench.control(0x1F)
        bench.run(60_000)
        assert bench.has(10, 12)
        assert bench.position == 0
        found.append(bench.drive._servo.zero)
    assert found[0] == found[1]


def test_a_file_that_says_zero_leaves_the_torque_unlimited() -> None:
    bench = Bench(DriveSettings(position=0, mechanics=JOINT, unset=frozenset({0x6072_00})))
    bench.preset(0x6072, 0)
    bench.enable(1)
    go(bench, 1_000)
    bench.run(1_000)
    assert bench.position == 1_000
    assert math.isclose(bench.read(0x60F4), 0)


@pytest.mark.parametrize("mechanics", [None, JOINT], ids=["lag", "mass"])
def test_bit_10_of_ip_does_not_flicker_while_the_axis_stands(mechanics: Mechanics | None) -> None:
    bench = Bench(DriveSettings(position=0, mechanics=mechanics))
    bench.enable(7)
    bench.put(0x60C1, 0, 1)
    bench.control(0x1F)
    for target in (*range(0, 1_000, 100), *[900] * 40):
        bench.put(0x60C1, target, 1)
        bench.sync()
    words = set()
    for _ in range(20):
        bench.put(0x60C1, 900, 1)
        bench.sync()
        words.add(bench.read(0x6041))
        bench.run(3)
        words.add(bench.read(0x6041))
    assert bench.position == 900
    assert words == {0x1637}
    bench.put(0x60C1, 950, 1)
    bench.sync()
    assert not bench.has(10)
