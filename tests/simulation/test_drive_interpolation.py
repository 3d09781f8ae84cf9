"""The simulated drive in interpolated position mode: one set-point per SYNC, buffer, underrun, halt, and the manual's frames."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND
from canopen_proto.simulation.drive.interpolated_position import SetPointLost, SetPointUnderrun
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.simulation.drive_bench import NODE_ID, Bench

ACTIVE, WARNING, REACHED, LIMIT = 12, 7, 10, 11


def interpolating(lag: int = 0, start: int = 1_000, shape: Shape = Shape.STANDARD) -> Bench:
    """A drive that stands at `start` in active interpolation."""
    bench = Bench(DriveSettings(position=start, lag=lag, shape=shape))
    bench.preset(0x60C2, 10, 1)
    bench.enable(7)
    bench.write(0x60C1, start, 1)
    bench.control(0x1F)
    assert bench.has(ACTIVE)
    return bench


def test_one_set_point_per_sync_is_reached_one_period_later() -> None:
    bench = interpolating()
    bench.sync()
    for step in range(1, 100):
        bench.put(0x60C1, 1_000 + 50 * step, 1)
        bench.sync()
        assert bench.position == 1_000 + 50 * (step - 1)
    bench.run(2)
    assert bench.position == 1_000 + 50 * 98 + 10
    assert bench.read(0x606B) == 5_000
    assert bench.reported(SetPointUnderrun) == []


def test_it_needs_the_edge_of_bit_4_in_operation_enabled() -> None:
    bench = Bench(DriveSettings(position=0, lag=0))
    bench.enable(7)
    for target in range(0, 500, 100):
        bench.put(0x60C1, target, 1)
        bench.sync()
    assert not bench.has(ACTIVE)
    assert bench.position == 0

    bench = Bench(DriveSettings(position=0, lag=0))
    bench.write(0x6060, 7)
    bench.control(0x06, 0x17)  # the bit stands before operation is enabled
    assert bench.control(0x1F) is State.OPERATION_ENABLED
    assert not bench.has(ACTIVE)
    bench.control(0x0F, 0x1F)
    assert bench.has(ACTIVE)


def test_the_manuals_frame_enables_operation_and_starts_in_one_word() -> None:
    """RPDO1 of the manual: controlword 0x1F, 16 bits of nothing, position; here from Switched on, as its sequence has it."""
    bench = Bench(DriveSettings(position=0, lag=0, shape=Shape.SCHUNK_POWERBALL))
    bench.preset(0x60C2, 10, 1)
    bench.write(0x6060, 7)
    bench.control(0x06, 0x07)
    for position in range(0, 1_000, 100):
        bench.put(0x6040, 0x1F)
        bench.put(0x6042, 0)
        bench.put(0x60C1, position, 1)
        bench.sync()
        assert bench.state is State.OPERATION_ENABLED
        assert bench.has(ACTIVE)
    assert bench.position == 800
    assert bench.has(8)  # Schunk: it moves
    bench.put(0x60C1, 900, 1)
    bench.sync()
    bench.run(50)
    assert not bench.has(8)


def test_the_period_is_60c2() -> None:
    bench = interpolating()
    bench.preset(0x60C2, 200, 1)
    bench.preset(0x60C2, -4, 2)  # 20 ms
    bench.put(0x60C1, 2_000, 1)
    bench.sync()
    bench.run(10)
    assert bench.position == 1_500
    bench.preset(0x60C2, 0, 1)  # an RPDO could write it: no division by zero
    bench.put(0x60C1, 3_000, 1)
    bench.sync()
    bench.run(10)
    assert bench.position == 3_000


def test_an_axis_that_stands_has_nothing_to_run_out_of() -> None:
    bench = interpolating()
    for _ in range(10):
        bench.sync()
    assert bench.has(ACTIVE)
    assert bench.reported(SetPointUnderrun) == []
    assert bench.position == 1_000


@pytest.mark.parametrize(("option", "deceleration"), [(1, 100_000), (2, 400_000)])
def test_underrun_stops_by_the_halt_option_code_and_is_reported(option: int, deceleration: int) -> None:
    bench = interpolating()
    bench.preset(0x605D, option)
    for step in range(1, 20):
        bench.put(0x60C1, 1_000 + 100 * step, 1)
        bench.sync()
    bench.events()
    bench.sync()  # no set-point
    assert bench.events() == [SetPointUnderrun(NODE_ID)]
    assert not bench.has(ACTIVE)
    assert bench.has(WARNING)
    for step in range(20, 40):  # too late: they are not followed
        bench.put(0x60C1, 1_000 + 100 * step, 1)
        bench.sync()
    assert bench.position == pytest.approx(2_900 + 10_000**2 / (2 * deceleration), abs=1)
    assert bench.state is State.OPERATION_ENABLED
    bench.control(0x0F)
    bench.put(0x60C1, bench.position, 1)
    bench.control(0x1F)
    assert bench.has(ACTIVE)
    assert not bench.has(WARNING)


def test_a_late_sync_joins_at_the_speed_it_had() -> None:
    bench = interpolating()
    bench.preset(0x60C5, 200_000)  # 2000 units/s more in a period, no more
    bench.preset(0x60C6, 200_000)
    position = 1_000
    for step in range(30):
        position += min(step * 10, 100)
        bench.put(0x60C1, position, 1)
        bench.sync(10 if step % 3 else 11)
    assert not bench.has(LIMIT)  # from rest the last step would have been too much


def test_halt_and_falling_bit_4_end_it_and_a_new_edge_begins_it() -> None:
    for word in (0x11F, 0x0F):
        bench = interpolating()
        for step in range(1, 10):
            bench.put(0x60C1, 1_000 + 100 * step, 1)
            bench.sync()
        bench.control(word)
        assert not bench.has(ACTIVE)
        bench.run(300)
        assert bench.position == pytest.approx(1_800 + 500, abs=1)  # the step to 1900 has just begun
        assert bench.has(REACHED)
        bench.put(0x60C1, bench.position, 1)
        bench.control(0x1F)
        assert bench.has(ACTIVE)


def test_leaving_operation_enabled_ends_it() -> None:
    bench = interpolating()
    bench.control(0x07)
    bench.control(0x1F)
    assert bench.has(ACTIVE)  # bit 4 was 0 in between
    bench.drive.raise_fault(0x5000, bench.now)
    assert not bench.has(ACTIVE)
    bench.put(0x6040, 0x9F)
    bench.put(0x6040, 0x1F)
    assert bench.state is State.SWITCH_ON_DISABLED


def test_disabled_the_buffer_keeps_the_latest_set_point() -> None:
    bench = interpolating()
    for target in (1_100, 1_200, 1_300):
        bench.write(0x60C1, target, 1)
    assert bench.read(0x60C4, 2) == 1
    bench.sync()
    assert bench.read(0x60C4, 2) == 0
    bench.run(10)
    assert bench.position == 1_300
    assert bench.reported(SetPointLost) == []


def test_enabled_the_buffer_is_a_fifo() -> None:
    bench = interpolating()
    bench.sync()
    bench.write(0x60C4, 1, 6)
    for number in range(1, 17):
        bench.write(0x60C1, 1_000 + 10 * number, 1)
    assert bench.read(0x60C4, 2) == 16
    assert bench.drive.check_write(0x60C1, 1, 5) == AbortCode.DEVICE_STATE
    bench.put(0x60C1, 5, 1)  # a PDO cannot be refused
    assert bench.reported(SetPointLost) == [SetPointLost(NODE_ID, 5)]
    for number in range(16):
        bench.sync()
        assert bench.position == 1_000 + 10 * number
    bench.write(0x60C1, 9_999, 1)
    bench.write(0x60C4, 0, 6)
    assert bench.read(0x60C4, 2) == 0


@pytest.mark.parametrize("by_sdo", [False, True])
def test_a_ring_drives_out_the_oldest(by_sdo: bool) -> None:
    bench = interpolating()
    bench.sync()
    bench.write(0x60C4, 1, 3)
    bench.write(0x60C4, 1, 6)
    for number in range(1, 18):
        (bench.write if by_sdo else bench.put)(0x60C1, 1_000 + 10 * number, 1)
    assert bench.reported(SetPointLost) == [SetPointLost(NODE_ID, 1_010)]
    bench.sync()
    bench.run(10)
    assert bench.position == 1_020


def test_the_buffer_may_be_enabled_before_the_mode_acts() -> None:
    bench = Bench()
    bench.write(0x60C4, 1, 6)
    bench.enable(7)
    bench.write(0x60C1, 1_000, 1)
    bench.write(0x60C1, 1_010, 1)
    assert bench.read(0x60C4, 2) == 2


def test_power_on_disables_the_buffer_again() -> None:
    bench = Bench()
    bench.enable(7)
    bench.write(0x60C4, 1, 6)
    bench.values.reset()  # as a node does for NMT reset node
    bench.drive.reset(bench.now)
    bench.enable(7)
    bench.write(0x60C1, 1_000, 1)
    bench.write(0x60C1, 1_010, 1)
    assert bench.read(0x60C4, 2) == 1


def test_software_limits_and_speed_limits_hold_in_interpolation() -> None:
    bench = interpolating()
    bench.preset(0x607D, 2_000, 2)
    for step in range(1, 30):
        bench.put(0x60C1, 1_000 + 100 * step, 1)
        bench.sync()
        assert bench.position <= 2_000
    assert bench.position == 2_000
    assert bench.has(LIMIT)

    bench = interpolating()
    bench.preset(0x607F, 20_000)
    bench.put(0x60C1, 0, 1)  # the manual starts from 0 wherever the axis is
    bench.sync()
    assert bench.has(LIMIT)
    bench.run(25)
    assert bench.position == pytest.approx(500, abs=1)
    bench.run(500)
    assert bench.position == 0


def test_the_axis_follows_its_demand_with_a_lag() -> None:
    bench = interpolating(lag=5 * MILLISECOND)
    for step in range(1, 100):
        bench.put(0x60C1, 1_000 + 100 * step, 1)
        bench.sync()
    assert bench.read(0x6062) - bench.position == pytest.approx(50, abs=1)  # 10000 units/s * 5 ms
    assert bench.read(0x60F4) == pytest.approx(50, abs=1)
    assert bench.read(0x6077) == pytest.approx(80, abs=1)  # load and friction


def test_a_fifo_shows_how_many_wait_and_where_the_next_goes() -> None:
    bench = interpolating()
    bench.sync()
    bench.write(0x60C4, 1, 6)
    for number in range(1, 17):
        bench.write(0x60C1, 1_000 + number, 1)
        assert (bench.read(0x60C4, 2), bench.read(0x60C4, 4)) == (number, number % 16)
    bench.sync()
    assert (bench.read(0x60C4, 2), bench.read(0x60C4, 4)) == (15, 0)


def test_in_a_ring_the_position_says_where_records_are_replaced() -> None:
    """A path that is already in the drive is changed in the middle, without a stop."""
    bench = interpolating()
    bench.sync()
    bench.write(0x60C4, 1, 3)
    bench.write(0x60C4, 1, 6)
    for number in range(1, 7):
        bench.write(0x60C1, 1_000 + 10 * number, 1)
    bench.write(0x60C4, 3, 4)
    for target in (1_035, 1_045):
        bench.write(0x60C1, target, 1)
    assert (bench.read(0x60C4, 2), bench.read(0x60C4, 4)) == (6, 5)
    reached = []
    for _ in range(7):
        bench.sync()
        reached.append(bench.position)
    assert reached == [1_000, 1_010, 1_020, 1_030, 1_035, 1_045, 1_060]
    assert bench.reported(SetPointLost) == []


def test_a_ring_that_was_written_past_its_end_goes_on_behind_it() -> None:
    bench = interpolating()
    bench.sync()
    bench.write(0x60C4, 1, 3)
    bench.write(0x60C4, 1, 6)
    target = 1_000
    for _ in range(40):
        target += 10
        bench.put(0x60C1, target, 1)
        bench.sync()
    bench.sync()
    assert bench.position == target
    assert bench.reported(SetPointLost) == []


def test_a_place_beyond_the_waiting_records_leaves_a_gap_in_which_the_axis_stops() -> None:
    bench = interpolating()
    bench.sync()
    bench.write(0x60C4, 1, 3)
    bench.write(0x60C4, 1, 6)
    for number in range(1, 4):
        bench.write(0x60C1, 1_000 + 10 * number, 1)
    bench.write(0x60C4, 5, 4)
    bench.write(0x60C1, 1_060, 1)
    for _ in range(5):
        bench.sync()
    assert bench.reported(SetPointUnderrun) == [SetPointUnderrun(NODE_ID)]
    assert not bench.has(ACTIVE)


def test_a_record_of_position_and_velocity_is_passed_at_that_velocity() -> None:
    bench = Bench(DriveSettings(position=0, lag=0))
    bench.preset(0x60C2, 10, 1)
    bench.write(0x60C0, -1)
    bench.enable(7)
    bench.control(0x1F)
    bench.put(0x60C1, 0, 1)
    bench.put(0x60C1, 0, 2)
    bench.sync()
    velocities = []
    for step in range(1, 30):  # half a t², 100,000 units/s²: each point with the velocity that belongs to it
        time = step * 0.01
        bench.put(0x60C1, round(50_000 * time * time), 1)
        assert bench.read(0x60C4, 2) == 0  # the velocity completes the record
        bench.put(0x60C1, round(100_000 * time), 2)
        bench.sync()
        assert bench.position == round(50_000 * (time - 0.01) ** 2)
        velocities.append(bench.read(0x606B))
    assert velocities == [1_000 * step for step in range(29)]
    bench.run(5)
    assert bench.read(0x606B) == 28_500  # between two points the velocity grows, too: a line would have one velocity there
    assert not bench.has(LIMIT)
    bench.sync(5)
    bench.sync()
    assert bench.reported(SetPointUnderrun) == [SetPointUnderrun(NODE_ID)]


def test_a_passage_beyond_the_drives_acceleration_is_cut() -> None:
    bench = Bench(DriveSettings(position=0, lag=0))
    bench.preset(0x60C2, 10, 1)
    bench.preset(0x60C5, 50_000)
    bench.write(0x60C0, -1)
    bench.enable(7)
    bench.control(0x1F)
    bench.put(0x60C1, 5, 1)
    bench.put(0x60C1, 1_000, 2)
    bench.sync()
    assert bench.has(LIMIT)


def test_a_drive_without_a_velocity_in_its_record_refuses_that_sub_mode() -> None:
    bench = Bench(DriveSettings(shape=Shape.SCHUNK_POWERBALL))
    assert bench.drive.check_write(0x60C0, 0, -1) == AbortCode.INVALID_VALUE
    assert Bench().drive.check_write(0x60C0, 0, -2) == AbortCode.INVALID_VALUE
