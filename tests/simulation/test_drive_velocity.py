"""The simulated drive's velocity modes: windows of pv; limits, factors, ramps and control bits of vl."""

from __future__ import annotations

import pytest

from canopen_proto.dictionary.model import ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import DriveSettings
from tests.simulation.drive_bench import Bench

REACHED, LIMIT, SPEED_ZERO, SLIPPAGE = 10, 11, 12, 13
ENABLE, UNLOCK, REFERENCE = 0x10, 0x20, 0x40
RUN = 0x0F | ENABLE | UNLOCK | REFERENCE


def with_encoder() -> ObjectDictionary:
    """A drive whose motor has 6000 counts a turn: 1 rpm is 100 counts per second."""
    encoder = standard_object(0x608F, highest=2, defaults={1: 6_000, 2: 1})
    return drive_dictionary().with_objects([encoder])


def in_velocity(lag: int = 0) -> Bench:
    bench = Bench(DriveSettings(position=0, lag=lag), with_encoder())
    bench.write(0x6048, 100, 1)  # rpm a second, as they follow
    bench.write(0x6049, 200, 1)
    bench.write(0x604A, 1_000, 1)
    bench.enable(2)
    return bench


# ---- profile velocity ----


def test_target_reached_waits_for_its_window_and_time() -> None:
    bench = Bench(DriveSettings(position=0, lag=5 * MILLISECOND))
    bench.preset(0x606D, 50)
    bench.preset(0x606E, 200)
    bench.enable(3)
    bench.run(300)
    assert bench.has(REACHED)
    bench.write(0x60FF, 10_000)
    bench.run(250)  # 0.1 s of ramp; some ms later the velocity is within 50 of it
    assert not bench.has(REACHED)
    bench.run(100)
    assert bench.has(REACHED)


def test_speed_zero_is_what_606f_says() -> None:
    bench = Bench(DriveSettings(position=0, lag=0))
    bench.preset(0x606F, 1_000)
    bench.preset(0x6070, 50)
    bench.enable(3)
    bench.run(100)
    assert bench.has(SPEED_ZERO)
    bench.write(0x60FF, 900)
    bench.run(200)
    assert bench.has(SPEED_ZERO)
    bench.write(0x60FF, 5_000)
    bench.run(200)
    assert not bench.has(SPEED_ZERO)
    bench.write(0x60FF, 0)
    bench.run(60)
    assert not bench.has(SPEED_ZERO)
    bench.run(60)
    assert bench.has(SPEED_ZERO)


def test_slippage() -> None:
    bench = Bench(DriveSettings(position=0, lag=5 * MILLISECOND))
    bench.preset(0x60F8, 1_000)
    bench.preset(0x6065, 2**32 - 1)
    bench.enable(3)
    bench.write(0x60FF, 10_000)
    bench.run(300)
    assert not bench.has(SLIPPAGE)
    bench.drive.block(True, bench.now)
    bench.run(50)
    assert bench.has(SLIPPAGE)


# ---- velocity ----


def test_the_target_is_in_revolutions_per_minute_and_the_ramp_its_own() -> None:
    bench = in_velocity()
    bench.write(0x6042, 50)
    bench.run(100)
    assert bench.read(0x606B) == 0  # without its bits
    bench.control(RUN)
    bench.run(250)
    assert bench.read(0x6043) == 25
    assert bench.read(0x606B) == 2_500
    bench.run(250)
    assert (bench.read(0x6043), bench.read(0x6044)) == (50, 50)
    bench.write(0x6042, 0)
    bench.run(125)
    assert bench.read(0x6043) == 25
    bench.run(200)
    assert bench.read(0x606C) == 0


@pytest.mark.parametrize(
    ("set_point", "dimension", "speed", "demand"),
    [((1, 1), (1, 1), 1_000, 10), ((3, 1), (1, 1), 3_000, 10), ((1, 1), (6, 1), 6_000, 10), ((1, 2), (-1, 1), -500, 10)],
)
def test_factors(set_point: tuple[int, int], dimension: tuple[int, int], speed: int, demand: int) -> None:
    bench = in_velocity()
    for index, factor in ((0x604B, set_point), (0x604C, dimension)):
        bench.write(index, factor[0], 1)
        bench.write(index, factor[1], 2)
    bench.write(0x6042, 10)
    bench.control(RUN)
    bench.run(2_000)
    assert (bench.read(0x606B), bench.read(0x6043)) == (speed, demand)


def test_ramps_are_in_the_unit_of_the_dimension_factor_and_not_of_the_set_point_factor() -> None:
    bench = in_velocity()
    bench.write(0x604B, 10, 1)
    bench.write(0x604C, 2, 1)
    bench.write(0x6042, 1_000)
    bench.control(RUN)
    bench.run(100)
    assert bench.read(0x606B) == 2 * 100 * 100 * 0.1


def test_limits_hold_with_either_sign_and_a_minimum_turns_even_a_target_of_0() -> None:
    bench = in_velocity()
    bench.write(0x6046, 5, 1)
    bench.write(0x6046, 20, 2)
    bench.control(RUN)
    for target, rpm, limited in ((10, 10, False), (100, 20, True), (-100, -20, True), (-1, -5, True), (0, 5, True)):
        bench.write(0x6042, target)
        bench.run(1_000)
        assert (bench.read(0x6044), bench.has(LIMIT)) == (rpm, limited)
    bench.control(RUN & ~REFERENCE)
    bench.run(1_000)
    assert bench.read(0x6044) == 0


def test_the_three_bits() -> None:
    bench = in_velocity()
    bench.write(0x6042, 100)
    bench.control(RUN)
    bench.run(500)
    assert bench.read(0x6043) == 50
    bench.control(RUN & ~UNLOCK)  # locked: the ramp stays where it is
    bench.run(500)
    assert bench.read(0x6043) == 50
    bench.control(RUN)
    bench.run(100)
    assert bench.read(0x6043) == 60
    bench.control(RUN & ~REFERENCE)  # to 0, by 6049h
    bench.run(100)
    assert bench.read(0x6043) == 40
    bench.control(RUN & ~ENABLE)  # to 0, by 604Ah
    bench.run(20)
    assert bench.read(0x6043) == 20


@pytest.mark.parametrize(("option", "left"), [(1, 80), (2, 0)])
def test_halt_brakes_by_the_ramps_of_this_mode(option: int, left: int) -> None:
    bench = in_velocity()
    bench.preset(0x605D, option)
    bench.write(0x6042, 100)
    bench.control(RUN)
    bench.run(1_000)
    bench.control(RUN | 0x100)
    bench.run(100)
    assert bench.read(0x6043) == left
    bench.run(1_000)
    bench.control(RUN)
    bench.run(1_000)
    assert bench.read(0x6043) == 100


def test_quick_stop_brakes_by_604a() -> None:
    bench = in_velocity()
    bench.write(0x6042, 100)
    bench.control(RUN)
    bench.run(1_000)
    assert bench.control(0x02) is State.QUICK_STOP_ACTIVE
    bench.run(50)
    assert bench.read(0x606B) == 5_000
    bench.run(60)
    assert bench.state is State.SWITCH_ON_DISABLED
