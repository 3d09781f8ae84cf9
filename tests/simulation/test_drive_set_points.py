"""The simulated drive's sets of set-points: waiting, blended, relative, with an end velocity; its rules for modes."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND
from canopen_proto.simulation.drive.settings import DriveSettings
from tests.examples import examples
from tests.simulation.drive_bench import Bench

REACHED, LIMIT, ACKNOWLEDGE = 10, 11, 12
NEW, AT_ONCE, RELATIVE, BLENDED = 0x10, 0x20, 0x40, 0x200


def in_profile_position(set_points: int = 1) -> Bench:
    bench = Bench(DriveSettings(position=0, lag=0, set_points=set_points))
    bench.enable(1)
    return bench


def give(bench: Bench, target: int, bits: int = 0) -> bool:
    """Give a set-point with its handshake; whether bit 12 rose for it."""
    bench.write(0x607A, target)
    bench.control(0x0F | bits)
    was = bench.has(ACKNOWLEDGE)
    bench.control(0x0F | bits | NEW)
    taken = bench.has(ACKNOWLEDGE) and not was
    bench.control(0x0F | bits)
    return taken


def test_the_set_point_before_is_left_at_its_own_velocity() -> None:
    """Change on set-point: at x1 the axis has the velocity of the first profile, then goes on with that of the second."""
    bench = in_profile_position()
    give(bench, 10_000)
    bench.preset(0x6081, 5_000)
    assert give(bench, 20_000, BLENDED)
    assert bench.has(ACKNOWLEDGE)
    bench.run(200 + 400)  # 2000 units to be at 20000/s, and 8000 at that speed
    assert bench.position == 10_000
    assert bench.read(0x606B) == 20_000
    assert not bench.has(ACKNOWLEDGE, REACHED)
    bench.run(150)
    assert bench.read(0x606B) == 5_000
    bench.run(3_000)
    assert bench.position == 20_000
    assert bench.has(REACHED)


def test_without_another_set_point_it_stops_at_the_one_before() -> None:
    bench = in_profile_position()
    give(bench, 10_000, BLENDED)
    bench.run(2_000)
    assert bench.position == 10_000
    assert bench.has(REACHED)


def test_a_blended_set_point_behind_waits_for_a_stop_where_the_way_turns_back() -> None:
    bench = in_profile_position()
    give(bench, 10_000)
    give(bench, 5_000, BLENDED)
    highest = 0
    for _ in range(200):
        bench.run(10)
        highest = max(highest, bench.position)
    assert highest == 10_000
    assert bench.position == 5_000


def test_the_axis_is_slow_enough_at_a_blended_set_point_to_stop_at_the_next() -> None:
    bench = in_profile_position()
    give(bench, 10_000)
    give(bench, 10_100, BLENDED)
    highest = 0
    for _ in range(200):
        bench.run(10)
        highest = max(highest, bench.position)
    assert highest == bench.position == 10_100


def test_a_halt_between_blended_set_points_goes_on_with_both() -> None:
    bench = in_profile_position()
    give(bench, 10_000)
    give(bench, 20_000, BLENDED)
    bench.run(300)
    bench.control(0x10F)
    bench.run(1_000)
    assert bench.read(0x606B) == 0
    assert bench.position < 10_000
    bench.control(0x0F)
    bench.run(3_000)
    assert bench.position == 20_000


def test_as_many_wait_as_the_drive_has_room_for() -> None:
    bench = in_profile_position(set_points=3)
    assert [give(bench, target) for target in (1_000, 2_000, 3_000, 4_000, 5_000)] == [True, True, True, True, False]
    seen = []
    for _ in range(200):
        bench.run(10)
        if bench.read(0x606B) == 0:
            seen.append(bench.position)
    assert seen[-1] == 4_000
    assert bench.has(REACHED)


def test_a_drive_in_which_none_can_wait_needs_bit_5() -> None:
    bench = in_profile_position(set_points=0)
    assert not give(bench, 1_000)
    assert give(bench, 1_000, AT_ONCE)
    assert not give(bench, 2_000)
    bench.run(1_000)
    assert bench.position == 1_000


@pytest.mark.parametrize(("option", "end"), [(0, 12_000), (1, 6_000), (2, 6_000)])
def test_a_relative_set_point_that_waits_counts_from_what_60f2_says_when_it_is_given(option: int, end: int) -> None:
    bench = in_profile_position()
    bench.preset(0x60F2, option)
    give(bench, 10_000)
    bench.run(300)
    assert bench.position == 4_000
    give(bench, 2_000, RELATIVE)
    bench.run(3_000)
    assert bench.position == end


def test_an_end_velocity_lasts_behind_the_target_until_the_next_set_point() -> None:
    bench = in_profile_position()
    bench.write(0x6082, 5_000)
    give(bench, 10_000)
    bench.run(2_000)
    assert bench.read(0x606B) == 5_000
    assert bench.position > 10_000
    bench.write(0x6082, 0)
    give(bench, 0)
    bench.run(3_000)
    assert bench.position == 0


def test_an_end_velocity_ends_at_the_software_limit() -> None:
    bench = in_profile_position()
    bench.preset(0x607D, -1_000, 1)
    bench.preset(0x607D, 12_000, 2)
    bench.write(0x6082, 5_000)
    give(bench, 10_000)
    bench.run(5_000)
    assert bench.position == 12_000
    give(bench, 20_000)  # beyond the limit: cut, and without the end velocity
    bench.run(1_000)
    assert bench.position == 12_000


STEP = 5
GIVEN = st.tuples(
    st.integers(-20_000, 20_000),  # the target
    st.sampled_from([0, AT_ONCE, BLENDED, RELATIVE, RELATIVE | AT_ONCE, RELATIVE | BLENDED]),
    st.sampled_from([500, 5_000, 20_000]),  # velocity
    st.sampled_from([20_000, 100_000]),  # both ramps
    st.sampled_from([0, 0, 3_000]),  # end velocity
    st.integers(0, 100),  # how many steps pass before it is given
    st.booleans(),  # whether a halt comes in the middle
)


@given(st.lists(GIVEN, min_size=1, max_size=6), st.integers(0, 3))
@example([(20_000, 0, 20_000, 100_000, 0, 0, False), (10, BLENDED, 500, 20_000, 3_000, 40, True)], 1)
@examples(40)
def test_whatever_set_points_come_velocity_and_acceleration_keep_to_their_limits(
    given_points: list[tuple[int, int, int, int, int, int, bool]], room: int
) -> None:
    bench = in_profile_position(room)
    fastest = max(velocity for _, _, velocity, _, _, _, _ in given_points)
    steepest = max(ramp for _, _, _, ramp, _, _, _ in given_points)
    last = 0.0

    def pass_time(steps: int) -> None:
        nonlocal last
        for _ in range(steps):
            bench.run(STEP)
            speed = bench.drive._servo.demand_velocity
            assert abs(speed) <= fastest + 1e-6
            assert abs(speed - last) <= steepest * STEP / 1_000 + 1e-3
            last = speed

    for target, bits, velocity, ramp, end_velocity, steps, halts in given_points:
        for index, value in ((0x6081, velocity), (0x6083, ramp), (0x6084, ramp), (0x6082, end_velocity)):
            bench.write(index, value)
        give(bench, target, bits)
        pass_time(steps)
        if halts:
            bench.control(0x10F)
            pass_time(20)
            bench.control(0x0F)
    bench.write(0x6082, 0)
    give(bench, 1_234, AT_ONCE)
    assert bench.has(ACKNOWLEDGE) is False
    while not bench.has(REACHED):
        pass_time(20)
    assert bench.position == pytest.approx(1_234, abs=10)


# ---- when it takes another mode ----

STATES = [State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED]


@pytest.mark.parametrize("highest", STATES)
def test_a_mode_is_taken_up_to_the_state_that_the_drive_allows(highest: State) -> None:
    for state, words in zip(STATES, ([], [0x06], [0x06, 0x07], [0x06, 0x07, 0x0F]), strict=True):
        bench = Bench(DriveSettings(mode_change_state=highest))
        bench.write(0x6060, 1)
        assert bench.control(0x00, *words) is state
        refused = STATES.index(state) > STATES.index(highest)
        assert bench.drive.check_write(0x6060, 0, 6) == (AbortCode.DEVICE_STATE if refused else None)
        assert bench.drive.check_write(0x6060, 0, 1) is None, "the mode that it has"
        bench.put(0x6060, 6)  # as an RPDO does
        assert bench.read(0x6061) == (1 if refused else 6)


def test_a_drive_that_keeps_its_mode_while_it_is_halted() -> None:
    bench = Bench(DriveSettings(changes_mode_halted=False))
    bench.enable(1)
    bench.control(0x10F)
    assert bench.drive.check_write(0x6060, 0, 6) == AbortCode.DEVICE_STATE
    bench.control(0x0F)
    assert bench.drive.check_write(0x6060, 0, 6) is None


def test_modes_of_the_maker() -> None:
    bench = Bench(DriveSettings(own_modes=frozenset({-3}), lag=5 * MILLISECOND))
    bench.enable(-3)
    assert bench.drive.check_write(0x6060, 0, -4) == AbortCode.INVALID_VALUE
