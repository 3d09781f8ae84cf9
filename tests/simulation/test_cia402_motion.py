"""Closed-form motion: examples that can be worked out by hand, and properties over any start, velocity and limits."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.machine import MILLISECOND, NEVER, SECOND
from canopen_proto.simulation.drive.motion import Profile, follow, hold, line, move, run, stop, through

positions = st.floats(-1e7, 1e7)
velocities = st.floats(-1e5, 1e5)
limits = st.floats(1.0, 1e6)


def times_of(profile: Profile) -> list[int]:
    """Times worth a look: the joints of the profile and some between."""
    seconds = [piece[0] for piece in profile.pieces]
    seconds += [(a + b) / 2 for a, b in itertools.pairwise(seconds)] + [seconds[-1] + 1.0]
    return sorted(profile.start + round(second * SECOND) for second in seconds)


def assert_continuous(profile: Profile) -> None:
    """Each piece ends where the next begins, in position and velocity."""
    scale = max(1.0, *(abs(piece[1]) for piece in profile.pieces))
    for (begin, position, velocity, acceleration, jerk), (end, next_position, next_velocity, *_) in itertools.pairwise(
        profile.pieces
    ):
        elapsed = end - begin
        assert elapsed >= 0.0
        rounding = 2 * math.ulp(end)  # of the time, which hours after the start is more than a nanosecond
        lost = 4 * math.ulp(abs(velocity * elapsed) + abs(acceleration) * elapsed**2)  # of ways that are longer than their sum
        where = position + velocity * elapsed + acceleration * elapsed**2 / 2 + jerk * elapsed**3 / 6
        speed = velocity + acceleration * elapsed + jerk * elapsed**2 / 2
        inexact = lost + rounding * max(abs(velocity), abs(next_velocity))
        assert where == pytest.approx(next_position, abs=1e-7 * scale + inexact)
        assert speed == pytest.approx(next_velocity, abs=1e-6 + 1e-9 * abs(velocity) + rounding * abs(acceleration))


def test_a_long_move_is_a_trapezoid() -> None:
    profile = move(5 * SECOND, 100.0, 0.0, 1100.0, max_velocity=100.0, acceleration=50.0, deceleration=100.0)
    # 2 s to full speed (100 units), 1 s to rest (50 units), 850 units at 100 units/s
    assert profile.end == (5 + 2) * SECOND + 8_500 * MILLISECOND + SECOND
    assert profile.at(5 * SECOND) == (100.0, 0.0, 50.0)
    assert profile.at(7 * SECOND) == (200.0, 100.0, 0.0)
    assert profile.at(8 * SECOND) == (300.0, 100.0, 0.0)
    assert profile.at(profile.end - 500 * MILLISECOND) == pytest.approx((1087.5, 50.0, -100.0))
    assert profile.at(profile.end) == (1100.0, 0.0, 0.0)
    assert profile.at(NEVER) == (1100.0, 0.0, 0.0)
    assert not profile.at_rest(profile.end - 1)
    assert profile.at_rest(profile.end)


def test_a_short_move_is_a_triangle() -> None:
    profile = move(0, 0.0, 0.0, -100.0, max_velocity=1000.0, acceleration=100.0, deceleration=100.0)
    assert profile.end == 2 * SECOND
    assert profile.at(SECOND) == pytest.approx((-50.0, -100.0, 100.0))


def test_a_move_onto_the_spot_is_over_at_once() -> None:
    profile = move(7, 12.0, 0.0, 12.0, 10.0, 10.0, 10.0)
    assert profile.end == 7
    assert profile.at(7) == (12.0, 0.0, 0.0)


def test_a_target_that_is_passed_before_the_axis_can_stop_is_reached_from_behind() -> None:
    profile = move(0, 0.0, 100.0, 10.0, max_velocity=100.0, acceleration=100.0, deceleration=100.0)
    assert profile.at(SECOND) == pytest.approx((50.0, 0.0, -100.0))  # stopped beyond
    assert profile.pieces[-1][1] == 10.0
    assert_continuous(profile)


def test_an_axis_that_moves_away_turns_round() -> None:
    profile = move(0, 0.0, -100.0, 10.0, max_velocity=100.0, acceleration=100.0, deceleration=200.0)
    assert profile.at(500 * MILLISECOND) == pytest.approx((-25.0, 0.0, 100.0))
    assert_continuous(profile)


def test_a_lower_speed_limit_is_reached_by_braking() -> None:
    profile = move(0, 0.0, 100.0, 1000.0, max_velocity=50.0, acceleration=10.0, deceleration=100.0)
    assert profile.at(500 * MILLISECOND) == pytest.approx((37.5, 50.0, 0.0))
    assert_continuous(profile)


def test_a_move_planned_on_its_own_braking_ramp_just_brakes() -> None:
    for velocity in (100.0, -100.0):
        profile = move(0, 0.0, velocity, velocity / 2, 1000.0, acceleration=30.0, deceleration=100.0)
        assert profile.end == pytest.approx(SECOND, abs=10)


def test_stop_hold_and_line() -> None:
    assert stop(0, 10.0, -20.0, 10.0).at(2 * SECOND) == (-10.0, 0.0, 0.0)
    assert stop(3, 10.0, 0.0, 10.0).at_rest(3)
    assert hold(0, 4.5).at(NEVER) == (4.5, 0.0, 0.0)
    step = line(SECOND, 100.0, 110.0, 0.01)
    assert step.at(SECOND + 5 * MILLISECOND) == pytest.approx((105.0, 1000.0, 0.0))
    assert step.at(0) == pytest.approx((100.0, 1000.0, 0.0))  # before its start: as at its start
    assert step.end == SECOND + 10 * MILLISECOND
    assert step.at(step.end) == (110.0, 0.0, 0.0)


def test_run_turns_through_zero_with_both_rates() -> None:
    profile = run(0, 0.0, -100.0, 50.0, acceleration=50.0, deceleration=100.0)
    assert profile.at(SECOND) == pytest.approx((-50.0, 0.0, 50.0))
    assert profile.at(2 * SECOND) == pytest.approx((-25.0, 50.0, 0.0))
    assert profile.at(12 * SECOND) == pytest.approx((475.0, 50.0, 0.0))
    assert not profile.at_rest(12 * SECOND)


def test_a_motion_that_outlives_the_clock_never_ends() -> None:
    assert move(0, -(2.0**31), 0.0, 2.0**31, 0.5, 1.0, 1.0).end == NEVER


@given(positions, velocities, positions, limits, limits, limits)
def test_a_move_ends_at_its_target_within_its_limits(
    position: float, velocity: float, target: float, max_velocity: float, acceleration: float, deceleration: float
) -> None:
    profile = move(0, position, velocity, target, max_velocity, acceleration, deceleration)
    assert profile.pieces[0][:1] == (0.0,)
    assert profile.pieces[-1][1:3] == (target, 0.0)
    fastest = max(max_velocity, abs(velocity)) * (1 + 1e-9)
    speeding_up, slowing_down = acceleration * (1 + 1e-9), deceleration * (1 + 1e-9)
    for now in times_of(profile):
        _, speed, change = profile.at(now)
        assert abs(speed) <= fastest
        assert abs(change) <= max(speeding_up, slowing_down)
    for begin, end in itertools.pairwise(profile.pieces):
        growing = abs(end[2]) > abs(begin[2])
        assert abs(begin[3]) <= (speeding_up if growing else slowing_down)
    assert_continuous(profile)


@given(positions, positions, limits, limits, limits)
def test_a_move_from_rest_never_turns_back(
    position: float, target: float, max_velocity: float, acceleration: float, deceleration: float
) -> None:
    profile = move(0, position, 0.0, target, max_velocity, acceleration, deceleration)
    places = [profile.at(now)[0] for now in times_of(profile)]
    slack = 1e-6 * max(1.0, abs(target), abs(position))
    for before, after in itertools.pairwise(places):
        assert (after - before) * math.copysign(1.0, target - position) >= -slack


@given(positions, velocities, positions, st.floats(10.0, 1e5), st.floats(10.0, 1e6), st.floats(10.0, 1e6), st.floats(0.0, 1.0))
def test_planning_anew_on_the_way_changes_nothing(
    position: float, velocity: float, target: float, max_velocity: float, acceleration: float, deceleration: float, share: float
) -> None:
    first = move(0, position, velocity, target, max_velocity, acceleration, deceleration)
    now = round(first.end * share)
    where, how_fast, _ = first.at(now)
    second = move(now, where, how_fast, target, max_velocity, acceleration, deceleration)
    # time-optimal both times; near the end, the square root magnifies what rounding did to the position
    size = max(1.0, abs(position), abs(target), velocity**2 / deceleration)
    slack = 1e-3 + 10 * math.sqrt(1e-9 * size / min(acceleration, deceleration))
    assert (second.end - first.end) * 1e-9 == pytest.approx(0.0, abs=slack)


@given(positions, velocities, velocities, limits, limits)
def test_run_reaches_its_speed_and_keeps_it(
    position: float, velocity: float, to_velocity: float, acceleration: float, deceleration: float
) -> None:
    profile = run(0, position, velocity, to_velocity, acceleration, deceleration)
    assert profile.at(profile.end + SECOND)[1] == to_velocity
    assert_continuous(profile)


@given(positions, velocities, limits)
def test_stop_brakes_over_the_shortest_distance(position: float, velocity: float, deceleration: float) -> None:
    profile = stop(0, position, velocity, deceleration)
    _, final_position, final_velocity, *_ = profile.pieces[-1]
    assert final_velocity == 0.0
    assert abs(final_position - position) == pytest.approx(velocity**2 / (2 * deceleration), rel=1e-9, abs=1e-6)
    assert_continuous(profile)


@given(positions, velocities, positions, st.floats(10.0, 1e5), st.floats(10.0, 1e6), st.floats(1e-4, 0.1), st.floats(0.0, 1.0))
def test_following_does_not_depend_on_when_one_looks(
    position: float, velocity: float, target: float, max_velocity: float, rate: float, lag: float, share: float
) -> None:
    profile = move(0, position, velocity, target, max_velocity, rate, rate)
    until = min(profile.end, 100 * SECOND)
    between = round(until * share)
    once = follow(profile, position, 0, until, lag)
    twice = follow(profile, follow(profile, position, 0, between, lag), between, until, lag)
    assert once == pytest.approx(twice, abs=1e-6 * max(1.0, abs(position), abs(target)))


def test_following_lags_behind_by_speed_times_lag_and_arrives() -> None:
    profile = move(0, 0.0, 0.0, 10_000.0, 1_000.0, 1_000.0, 1_000.0)
    now = 5 * SECOND
    assert profile.at(now)[0] - follow(profile, 0.0, 0, now, 0.01) == pytest.approx(10.0)
    assert follow(profile, 0.0, 0, profile.end + SECOND, 0.01) == pytest.approx(10_000.0)
    assert follow(hold(0, 1.0), 0.0, 0, 10 * MILLISECOND, 0.01) == pytest.approx(1 - 1 / math.e)
    assert follow(hold(0, 1.0), 0.5, 7, 7, 0.01) == 0.5


def test_through_a_target_at_a_speed() -> None:
    profile = through(0, 0.0, 0.0, 1000.0, 100.0, 50.0, 100.0, end_velocity=20.0)
    assert profile.at(profile.end)[:2] == pytest.approx((1000.0, 20.0))
    assert profile.at(profile.end + SECOND)[:2] == pytest.approx((1020.0, 20.0))
    assert not profile.at_rest(NEVER)


@given(positions, velocities, positions, limits, limits, limits, st.floats(0.0, 1.0))
def test_through_keeps_to_its_limits_and_passes_the_target_at_its_speed_if_it_can(
    position: float, velocity: float, target: float, fastest: float, acceleration: float, deceleration: float, share: float
) -> None:
    end_velocity = fastest * share
    profile = through(0, position, velocity, target, fastest, acceleration, deceleration, end_velocity)
    assert_continuous(profile)
    distance = abs(target - position)
    allowed = max(fastest, abs(velocity)) * (1 + 1e-9) + 1e-6
    assert all(abs(piece[2]) <= allowed for piece in profile.pieces)
    assert {abs(piece[3]) for piece in profile.pieces} <= {0.0, acceleration, deceleration}
    assert profile.pieces[-1][1] == target
    towards = velocity * (target - position) >= 0
    slows = velocity * velocity - end_velocity * end_velocity <= 2 * deceleration * distance
    speeds_up = end_velocity * end_velocity <= (velocity * velocity if towards else 0.0) + 2 * acceleration * distance
    if towards and slows and speeds_up:
        assert abs(profile.final_velocity) == pytest.approx(end_velocity, rel=1e-6, abs=1e-3)
