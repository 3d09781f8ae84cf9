"""The simulated drive in profile position, csp and the velocity modes: handshake, halt, limits, following error."""

from __future__ import annotations

import math

import pytest

from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND, NEVER
from canopen_proto.simulation.drive.events import DriveFault
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.simulation.drive_bench import NODE_ID, Bench

ACKNOWLEDGE, FOLLOWING_ERROR, REACHED, LIMIT = 12, 13, 10, 11


def in_profile_position(position: float = 0.0, lag: int = 5 * MILLISECOND) -> Bench:
    bench = Bench(DriveSettings(position=position, lag=lag))
    bench.enable(1)
    return bench


# ---- profile position ----


def test_a_set_point_with_its_handshake() -> None:
    bench = in_profile_position()
    assert bench.has(REACHED)
    assert not bench.has(ACKNOWLEDGE)
    bench.write(0x607A, 10_000)
    assert bench.position == 0  # nothing moves before the edge
    bench.control(0x1F)
    assert bench.has(ACKNOWLEDGE)
    assert not bench.has(REACHED)
    bench.control(0x0F)
    assert not bench.has(ACKNOWLEDGE)
    bench.run(350)
    assert bench.read(0x606B) == 20_000  # 6081h
    assert bench.read(0x606C) == pytest.approx(20_000, rel=1e-3)
    assert bench.read(0x60F4) == pytest.approx(20_000 * 0.005, abs=1)
    bench.run(350)  # 0.2 s up, 0.2 s down, 6000 units between: 0.7 s
    assert bench.read(0x6062) == 10_000
    bench.run(60)
    assert bench.has(REACHED)
    assert bench.position == 10_000
    assert bench.drive.deadline == NEVER


def test_the_same_word_again_gives_no_second_set_point() -> None:
    bench = in_profile_position()
    bench.write(0x607A, 1_000)
    bench.control(0x5F)  # relative
    for _ in range(50):
        bench.run(10)
        bench.control(0x5F)
    assert bench.position == 1_000
    assert bench.has(ACKNOWLEDGE, REACHED)  # bit 4 still stands
    bench.control(0x0F, 0x5F)
    bench.run(500)
    assert bench.position == 2_000


def test_a_second_set_point_waits_and_a_third_finds_no_room() -> None:
    bench = in_profile_position()
    for target in (10_000, 5_000):
        bench.write(0x607A, target)
        bench.control(0x1F, 0x0F)
    assert bench.has(ACKNOWLEDGE)  # one runs, one waits: no room, says bit 12
    bench.write(0x607A, 77)
    bench.control(0x1F, 0x0F)
    bench.run(705)
    assert bench.read(0x606B) < 0  # the second has begun, at the very end of the first
    assert not bench.has(ACKNOWLEDGE)
    bench.run(600)
    assert bench.position == 5_000
    assert bench.has(REACHED)


def test_a_set_point_that_waits_starts_when_the_first_ends_however_coarse_the_wakes() -> None:
    bench = in_profile_position(lag=0)
    bench.write(0x607A, 10_000)
    bench.control(0x1F, 0x0F)
    bench.write(0x607A, 0)
    bench.control(0x1F, 0x0F)
    bench.run(800)  # 0.7 s there, 0.1 s of the way back: 100000 / 2 * 0.1²
    assert bench.position == 9_500


def test_change_set_immediately_drops_what_runs_and_what_waits() -> None:
    bench = in_profile_position()
    for target in (10_000, 5_000):
        bench.write(0x607A, target)
        bench.control(0x1F, 0x0F)
    bench.run(300)
    speed = bench.read(0x606B)
    bench.write(0x607A, -3_000)
    bench.control(0x3F)
    assert bench.has(ACKNOWLEDGE)
    assert bench.read(0x606B) == speed  # no jump in speed
    bench.control(0x0F)
    bench.run(2_000)
    assert bench.position == -3_000


@pytest.mark.parametrize(("option", "target"), [(0, 15_000), (1, 9_000), (2, 8_900), (3, 15_000)])
def test_relative_to_what_60f2_says(option: int, target: int) -> None:
    bench = in_profile_position()
    bench.preset(0x60F2, option)
    bench.write(0x607A, 10_000)
    bench.control(0x1F, 0x0F)
    bench.run(300)
    assert (bench.read(0x6062), bench.position) == (4_000, 3_900)  # demand, and 5 ms behind
    bench.write(0x607A, 5_000)
    bench.control(0x7F, 0x0F)
    bench.run(2_000)
    assert bench.position == target


def test_halt_stops_by_its_option_code_and_goes_on() -> None:
    for option, braking in ((1, 200), (2, 50)):
        bench = in_profile_position()
        bench.preset(0x605D, option)
        bench.write(0x607A, 100_000)
        bench.control(0x1F, 0x0F)
        bench.run(1_000)
        bench.control(0x10F)
        bench.run(braking - 10)
        assert bench.read(0x606B) > 0
        assert not bench.has(REACHED)
        bench.run(10)
        assert bench.read(0x606B) == 0
        bench.run(100)
        assert bench.state is State.OPERATION_ENABLED
        assert bench.has(REACHED)  # with halt: it stands
        stood = bench.position
        bench.control(0x0F)
        assert not bench.has(REACHED)
        bench.run(10_000)
        assert stood < 100_000
        assert bench.position == 100_000


def test_a_set_point_given_in_halt_starts_when_halt_ends() -> None:
    bench = in_profile_position()
    bench.control(0x10F)
    bench.write(0x607A, 2_000)
    bench.control(0x11F)
    assert bench.has(ACKNOWLEDGE)
    bench.run(500)
    assert bench.position == 0
    bench.control(0x0F)
    bench.run(500)
    assert bench.position == 2_000


def test_target_reached_waits_for_the_window_time() -> None:
    bench = in_profile_position(lag=0)
    bench.preset(0x6068, 300)
    bench.write(0x607A, 10_000)
    bench.control(0x1F, 0x0F)
    bench.run(990)
    assert bench.position == 10_000
    assert not bench.has(REACHED)
    bench.run(20)
    assert bench.has(REACHED)


def test_without_a_position_window_the_end_of_the_demand_is_enough() -> None:
    bench = in_profile_position()
    bench.preset(0x6067, 2**32 - 1)
    bench.preset(0x6065, 2**32 - 1)
    bench.drive.block(True, bench.now)
    bench.write(0x607A, 1_000)
    bench.control(0x1F)
    bench.run(300)
    assert bench.has(REACHED)
    assert bench.position == 0


def test_speed_and_acceleration_are_limited_by_607f_60c5_and_60c6() -> None:
    bench = in_profile_position(lag=0)
    for index, value in ((0x607F, 1_000), (0x60C5, 10_000), (0x60C6, 5_000)):
        bench.preset(index, value)
    bench.write(0x607A, 10_000)
    bench.control(0x1F)
    bench.run(50)
    assert bench.read(0x606C) == 500
    bench.run(5_000)
    assert bench.read(0x606C) == 1_000
    bench.run(5_000)  # 10000 / 1000 + 0.1 / 2 + 0.2 / 2 s
    assert bench.read(0x606C) == pytest.approx(500, abs=1)


def test_speeds_of_0_are_as_good_as_standing() -> None:
    bench = in_profile_position()
    for index in (0x6081, 0x6083, 0x6084):
        bench.preset(index, 0)
    bench.write(0x607A, 2**31 - 1)
    bench.control(0x1F)
    bench.run(10_000)
    assert 0 <= bench.position <= 10


def test_software_limits_cut_a_target() -> None:
    bench = in_profile_position()
    bench.preset(0x607D, -1_000, 1)
    bench.preset(0x607D, 2_000, 2)
    for target, end in ((5_000, 2_000), (-5_000, -1_000)):
        bench.write(0x607A, target)
        bench.control(0x1F, 0x0F)
        assert bench.has(LIMIT)
        bench.run(1_000)
        assert bench.position == end
        assert bench.has(REACHED)
    bench.write(0x607A, 0)
    bench.control(0x1F, 0x0F)
    assert not bench.has(LIMIT)
    bench.preset(0x607D, 2_000, 1)  # the lower not below the upper one: off
    bench.write(0x607A, 9_000)
    bench.control(0x1F, 0x0F)
    bench.run(2_000)
    assert bench.position == 9_000


# ---- following error ----


def test_a_blocked_axis_is_a_following_error() -> None:
    bench = in_profile_position()
    bench.drive.block(True, bench.now)
    bench.write(0x607A, 100_000)
    bench.control(0x1F)
    bench.run(590)  # more than 10000 (6065h) behind after 0.6 s
    assert not bench.has(FOLLOWING_ERROR)
    bench.run(30)
    assert bench.has(FOLLOWING_ERROR)
    assert bench.read(0x60F4) > 10_000
    assert bench.read(0x6077) == 1_000  # it pushes as hard as it can
    assert bench.state is State.OPERATION_ENABLED
    bench.run(120)  # 6066h: 100 ms
    assert bench.reported(DriveFault) == [DriveFault(NODE_ID, 0x8611, 0x21)]
    bench.run(100)
    assert bench.state is State.FAULT
    assert bench.position == 0
    assert bench.read(0x6077) == 0
    bench.drive.block(False, bench.now)
    bench.run(100)
    assert bench.position == 0  # without power nothing makes up for it
    bench.control(0x00, 0x80, 0x06, 0x07, 0x0F)
    bench.write(0x607A, 1_000)
    bench.control(0x1F)
    bench.run(1_000)
    assert bench.position == 1_000


def test_a_short_deviation_is_no_fault() -> None:
    bench = in_profile_position()
    bench.preset(0x6066, 500)
    bench.drive.block(True, bench.now)
    bench.write(0x607A, 30_000)
    bench.control(0x1F)
    bench.run(800)
    assert bench.has(FOLLOWING_ERROR)
    bench.drive.block(False, bench.now)
    bench.run(50)
    assert not bench.has(FOLLOWING_ERROR)
    bench.run(2_000)
    assert bench.position == 30_000
    assert bench.state is State.OPERATION_ENABLED


def test_a_window_of_all_ones_switches_the_supervision_off() -> None:
    bench = in_profile_position()
    bench.preset(0x6065, 2**32 - 1)
    bench.drive.block(True, bench.now)
    bench.write(0x607A, 100_000)
    bench.control(0x1F)
    bench.run(20_000)
    assert bench.state is State.OPERATION_ENABLED


# ---- csp ----


def test_csp_takes_the_target_at_each_sync_and_is_there_one_period_later() -> None:
    bench = Bench(DriveSettings(position=0, lag=0))
    bench.enable(8)
    assert bench.has(12)
    for step in range(1, 50):
        bench.write(0x607A, 100 * step)
        bench.sync()
        assert bench.position == 100 * (step - 1)
    bench.run(5)
    assert bench.position == 4850
    bench.run(5)
    assert bench.position == 4900


def test_csp_halts_and_ignores_its_target_then() -> None:
    bench = Bench(DriveSettings(position=0, lag=0))
    bench.enable(8)
    for step in range(1, 20):
        bench.write(0x607A, 100 * step)
        bench.sync()
    bench.control(0x10F)
    assert not bench.has(12)
    for step in range(20, 40):
        bench.write(0x607A, 100 * step)
        bench.sync()
    stood = bench.position
    assert 1_800 < stood < 2_600  # 10000²/200000 to brake
    bench.control(0x0F)
    assert bench.has(12)
    bench.sync()
    bench.run(100)
    assert bench.position == 3_900


def test_a_jump_beyond_the_limits_is_approached_by_a_profile() -> None:
    bench = Bench(DriveSettings(position=0, lag=0))
    bench.preset(0x607F, 10_000)
    bench.preset(0x60C5, 100_000)
    bench.preset(0x60C6, 100_000)
    bench.enable(8)
    bench.write(0x607A, 5_000)
    highest = 0
    for _ in range(80):
        bench.sync()
        highest = max(highest, bench.read(0x606C))
        assert bench.read(0x606C) <= 10_000
    assert highest == 10_000
    assert bench.position == 5_000
    bench.sync()
    assert not bench.has(LIMIT)


# ---- velocity modes ----


def test_profile_velocity() -> None:
    bench = Bench(DriveSettings(position=0))
    bench.enable(3)
    assert bench.has(12, REACHED)
    bench.write(0x60FF, -10_000)
    assert not bench.has(REACHED)
    bench.run(50)
    assert bench.read(0x606B) == -5_000
    bench.run(100)
    assert bench.read(0x606B) == -10_000
    assert bench.has(REACHED)
    assert not bench.has(12)
    bench.control(0x10F)
    bench.write(0x60FF, 10_000)
    bench.run(200)
    assert bench.read(0x606C) == 0
    assert bench.has(12, REACHED)
    bench.control(0x0F)
    bench.run(150)
    assert bench.read(0x606B) == 10_000


def test_profile_velocity_ends_at_the_software_limit() -> None:
    bench = Bench(DriveSettings(position=0))
    bench.preset(0x607D, -1_000, 1)
    bench.preset(0x607D, 2_000, 2)
    bench.enable(3)
    for speed, end in ((10_000, 2_000), (-10_000, -1_000)):
        bench.write(0x60FF, speed)
        bench.run(2_000)
        assert bench.position == end
        assert bench.has(LIMIT)


def test_an_axis_that_turns_for_ever_starts_again_at_the_other_end() -> None:
    bench = Bench(DriveSettings(position=2**31 - 1_000, track=Track(-math.inf, math.inf)))
    bench.preset(0x607D, 0, 1)
    bench.preset(0x607D, 0, 2)
    bench.enable(3)
    bench.write(0x60FF, 10_000)
    bench.run(1_000)
    assert bench.position < -(2**31) + 10_000
    assert bench.has(REACHED)


def test_velocity_mode_of_the_powerball_needs_its_three_bits() -> None:
    bench = Bench(DriveSettings(shape=Shape.SCHUNK_POWERBALL, position=0))
    bench.enable(2)
    bench.write(0x6042, 5_000)
    bench.run(100)
    assert bench.read(0x606C) == 0
    bench.control(0x7F)
    bench.run(100)
    assert bench.read(0x606B) == 5_000
    bench.write(0x6042, -5_000)
    bench.run(200)
    assert bench.read(0x606B) == -5_000
    bench.control(0x3F)
    bench.run(200)
    assert bench.read(0x606B) == 0
