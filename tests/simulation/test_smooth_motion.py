"""Profiles with limited jerk: the theory of seven segments, properties from any state, and the drive that uses them."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.simulation.drive.motion import Profile, follow
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings
from canopen_proto.simulation.drive.smooth_motion import ProfileLimits, move, run
from tests.examples import examples
from tests.simulation.drive_bench import Bench

EQUAL = ProfileLimits(velocity=100.0, acceleration=200.0, deceleration=200.0, jerk_up=1_000.0, jerk_down=1_000.0)
rates = st.floats(10.0, 1e5)
any_limits = st.builds(ProfileLimits, rates, rates, rates, rates, rates)
fractions = st.floats(-1.0, 1.0)
positions = st.floats(-1e6, 1e6)


def duration(profile: Profile) -> float:
    return (profile.end - profile.start) / SECOND


def assert_smooth(profile: Profile) -> None:
    """Position, velocity and acceleration have no step."""
    scale, fastest, hardest, sharpest = (max(1.0, *(abs(piece[place]) for piece in profile.pieces)) for place in (1, 2, 3, 4))
    rounding = 4 * math.ulp(profile.pieces[-1][0])  # of the time, after hours
    for piece, following in itertools.pairwise(profile.pieces):
        begin, position, velocity, acceleration, jerk = piece
        time = following[0] - begin
        assert time >= 0.0
        where = position + velocity * time + acceleration * time**2 / 2 + jerk * time**3 / 6
        assert following[1] == pytest.approx(where, abs=2e-6 + 1e-9 * scale + rounding * fastest)
        assert following[2] == pytest.approx(
            velocity + acceleration * time + jerk * time**2 / 2, abs=1e-6 + 1e-8 * fastest + rounding * hardest
        )
        assert following[3] == pytest.approx(acceleration + jerk * time, abs=1e-6 + 1e-8 * hardest + rounding * sharpest)


def extremes(profile: Profile) -> tuple[float, float, float]:
    """The greatest speed, acceleration and jerk: at the joints, and where the acceleration passes 0 between them."""
    speeds, accelerations = [], []
    for piece, following in itertools.pairwise(profile.pieces):
        begin, _, velocity, acceleration, jerk = piece
        speeds += [velocity, following[2]]
        accelerations += [acceleration, following[3]]
        if jerk and 0.0 < -acceleration / jerk < following[0] - begin:
            speeds.append(velocity - acceleration**2 / jerk / 2)
    jerks = [piece[4] for piece in profile.pieces]
    return max(map(abs, speeds), default=0.0), max(map(abs, accelerations), default=0.0), max(map(abs, jerks))


@pytest.mark.parametrize(
    ("distance", "expected"),
    [
        (1_000.0, 1_000 / 100 + 100 / 200 + 200 / 1_000),  # seven segments: s/v + v/a + a/j
        (32.0, 0.2 + math.sqrt(0.2**2 + 4 * 32 / 200)),  # v is not reached, a is: ta = a/j, T = ta + √(ta² + 4 s/a)
        (2.0, 4 * (2 / 2 / 1_000) ** (1 / 3)),  # nor a: four equal pieces of jerk
    ],
)
def test_a_move_between_two_points_of_rest_takes_the_time_of_theory(distance: float, expected: float) -> None:
    for sign in (1, -1):
        profile = move(SECOND, 5.0, 0.0, 0.0, 5.0 + sign * distance, EQUAL)
        assert duration(profile) == pytest.approx(expected, rel=1e-6)
        assert profile.at(profile.end) == (5.0 + sign * distance, 0.0, 0.0)
        assert_smooth(profile)


def test_a_move_onto_the_spot_is_over_at_once() -> None:
    assert duration(move(7, 12.0, 0.0, 0.0, 12.0, EQUAL)) == pytest.approx(0.0, abs=1e-6)


def test_speeding_up_and_slowing_down_have_their_own_limits() -> None:
    limits = ProfileLimits(100.0, 400.0, 100.0, 8_000.0, 500.0)
    profile = move(0, 0.0, 0.0, 0.0, 1_000.0, limits)
    up, down = 100 / 400 + 400 / 8_000, 100 / 100 + 100 / 500
    assert duration(profile) == pytest.approx(up + down + (1_000 - 50 * (up + down)) / 100, rel=1e-6)


@given(positions, fractions, fractions, positions, any_limits)
@examples(300)
def test_from_any_state_it_ends_at_its_target_within_its_limits(
    position: float, speed: float, change: float, target: float, limits: ProfileLimits
) -> None:
    """The state is within the limits, and so that the acceleration can end before the speed is beyond its limit."""
    jerk = min(limits.jerk_up, limits.jerk_down)
    acceleration = change * min(limits.acceleration, limits.deceleration, math.sqrt(2.0 * jerk * limits.velocity))
    room = limits.velocity - acceleration**2 / 2.0 / jerk
    velocity = speed * room
    profile = move(0, position, velocity, acceleration, target, limits)
    assert_smooth(profile)
    assert profile.pieces[-1][1:4] == (target, 0.0, 0.0)
    fastest, hardest, sharpest = extremes(profile)
    assert fastest <= limits.velocity * (1 + 1e-6) + 1e-6
    assert hardest <= max(limits.acceleration, limits.deceleration) * (1 + 1e-6)
    assert sharpest <= max(limits.jerk_up, limits.jerk_down) * (1 + 1e-6)


@given(positions, fractions, st.floats(-3.0, 3.0), positions, any_limits)
@examples(100)
def test_a_state_beyond_the_limits_is_brought_back_without_a_step(
    position: float, speed: float, change: float, target: float, limits: ProfileLimits
) -> None:
    """Limits that were lowered meanwhile, or a brake that was harder."""
    profile = move(0, position, 3.0 * speed * limits.velocity, change * limits.deceleration, target, limits)
    assert_smooth(profile)
    assert profile.pieces[-1][1:4] == (target, 0.0, 0.0)


@given(fractions, fractions, st.floats(-1e4, 1e4), any_limits)
@examples(100)
def test_a_run_ends_at_its_velocity_without_a_step(
    speed: float, change: float, to_velocity: float, limits: ProfileLimits
) -> None:
    velocity, acceleration = speed * limits.velocity, change * min(limits.acceleration, limits.deceleration)
    profile = run(0, 0.0, velocity, acceleration, to_velocity, limits)
    assert_smooth(profile)
    assert profile.final_velocity == to_velocity
    _, hardest, sharpest = extremes(profile)
    assert hardest <= max(limits.acceleration, limits.deceleration) * (1 + 1e-6)
    assert sharpest <= max(limits.jerk_up, limits.jerk_down) * (1 + 1e-6)


def test_the_lag_follows_it_exactly() -> None:
    """In one look or in many; and as small steps of y' = (u - y) / lag do."""
    profile = move(0, 0.0, 0.0, 0.0, 50.0, EQUAL)
    lag, until = 0.05, 600 * MILLISECOND
    many, stepped = 0.0, 0.0
    for millisecond in range(600):
        since, now = millisecond * MILLISECOND, (millisecond + 1) * MILLISECOND
        many = follow(profile, many, since, now, lag)
        for part in range(20):
            stepped += (profile.at(since + part * MILLISECOND // 20)[0] - stepped) / lag * 5e-5
    assert many == pytest.approx(follow(profile, 0.0, 0, until, lag), abs=1e-9)
    assert many == pytest.approx(stepped, abs=0.02)


# ---- in the drive ----


def enabled(mode: int, mechanics: Mechanics | None = None) -> Bench:
    bench = Bench(DriveSettings(position=0, lag=0, mechanics=mechanics))
    bench.write(0x6086, 3)
    bench.write(0x60A4, 500_000, 1)
    bench.enable(mode)
    return bench


def accelerations(bench: Bench, milliseconds: int) -> list[float]:
    """Of the velocity actual value, units/s², each 10 ms."""
    seen, before = [], bench.read(0x606C)
    for _ in range(milliseconds // 10):
        bench.run(10)
        seen.append((bench.read(0x606C) - before) / 0.01)
        before = bench.read(0x606C)
    return seen


def test_profile_position_with_limited_jerk_takes_the_time_of_theory() -> None:
    bench = enabled(1)
    bench.write(0x607A, 40_000)
    bench.control(0x1F)
    expected = 40_000 / 20_000 + 20_000 / 100_000 + 100_000 / 500_000
    bench.run(expected * 1_000 - 20)
    assert not bench.has(10)
    bench.run(21)
    assert bench.has(10)
    assert bench.position == 40_000


def test_a_new_target_on_the_way_makes_no_step_of_the_acceleration() -> None:
    bench = enabled(1)
    bench.write(0x607A, 40_000)
    bench.control(0x1F)
    seen = accelerations(bench, 150)  # the acceleration is still rising
    for target in (3_000, 60_000, -5_000):
        bench.write(0x607A, target)
        bench.control(0x0F, 0x3F)
        seen += accelerations(bench, 250)
    bench.run(5_000)
    assert bench.position == -5_000
    assert max(abs(after - before) for before, after in itertools.pairwise(seen)) <= 500_000 * 0.01 + 200  # rounded velocities
    assert max(map(abs, seen)) <= 100_200


def test_profile_velocity_with_limited_jerk() -> None:
    bench = enabled(3)
    bench.write(0x60FF, 20_000)
    seen = accelerations(bench, 390)
    assert bench.read(0x606C) < 20_000
    bench.run(20)
    assert bench.read(0x606C) == 20_000
    assert max(abs(after - before) for before, after in itertools.pairwise([0.0, *seen])) <= 5_200


def test_two_jerks_and_linear_ramps_again() -> None:
    bench = enabled(3)
    bench.write(0x60A4, 5_000_000, 2)
    bench.write(0x60A3, 2)
    bench.write(0x60FF, 20_000)
    bench.run(1_000)
    bench.write(0x60FF, 0)
    bench.run(200 + 20 + 1)  # v/a + a/j
    assert bench.read(0x606B) == 0
    bench.write(0x6086, 0)
    bench.write(0x60FF, 20_000)
    bench.run(200)
    assert bench.read(0x606B) == 20_000


def test_limited_jerk_spares_the_torque() -> None:
    """With feed-forward the torque is J a + b v + Tc: it steps with linear ramps, and does not with smooth ones."""
    steps = []
    for kind in (0, 3):
        bench = enabled(1, Mechanics(coulomb_friction=0.0))
        bench.write(0x6086, kind)
        bench.write(0x607A, 40_000)
        bench.control(0x1F)
        seen = []
        for _ in range(400):
            bench.run(2)
            seen.append(bench.read(0x6077))
        steps.append(max(abs(after - before) for before, after in itertools.pairwise(seen)))
    assert steps[1] < steps[0] / 5


def test_a_file_without_a_jerk_leaves_the_drive_its_own() -> None:
    bench = Bench(DriveSettings(position=0, unset=frozenset({0x60A4_01})))
    bench.write(0x6086, 3)
    bench.preset(0x60A4, 0, 1)
    bench.enable(1)
    bench.write(0x607A, 1_000)
    bench.control(0x1F)
    bench.run(2_000)
    assert bench.position == 1_000
