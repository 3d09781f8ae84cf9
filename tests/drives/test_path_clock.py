"""The clock of a path: whatever it is told, the joints stay on the path and within their limits, as a drive would see them.

The oracle is not ours: difference quotients of the positions that come out, one a cycle.
"""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.drives.trajectory import JointLimits, Path, PathClock, PathError, Segment, first_violation
from canopen_proto.drives.trajectory.margin import rest_time
from tests.drives.paths import CYCLE, State, differences, limits_with_margin, through
from tests.examples import examples

ROUNDING = 1e-6
"""Limits count as kept up to this part of them. Third differences of positions near 1 have an error of 8e-16 / 0.004**3 s."""

REST_TO_REST = Path(
    [
        through([(0, 0, 0), (1.0, 0.4, 0), (0.5, 0, 0)], [1.0, 1.5]),
        through([(2, 0, 0), (-1.0, 0, 0)], [2.5]),
    ]
)
MOVING_ENDS = Path([through([(0, 0.5, 0.2), (1.0, 0.4, 0), (0.5, -1.0, 0.3)], [1.0, 1.5])])

value = st.floats(-1, 1).map(lambda each: round(each, 3))
state = st.tuples(value, value, value)


@st.composite
def paths(draw: st.DrawFn) -> Path:
    """One to three joints, one to three segments each, at rest at the ends or not."""
    rows = []
    durations = draw(st.lists(st.floats(0.3, 1.5), min_size=1, max_size=3))
    for _ in range(draw(st.integers(1, 3))):
        states: list[State] = [draw(state) for _ in range(len(durations) + 1)]
        if draw(st.booleans()):
            states[0], states[-1] = (states[0][0], 0, 0), (states[-1][0], 0, 0)
        rows.append(through(states, durations))
    return Path(rows)


actions = st.lists(
    st.tuples(
        st.integers(0, 250),
        st.one_of(st.sampled_from(["stop", "resume"]), st.sampled_from([0.0, 0.01, 0.5, 1.0]), st.floats(0, 1)),
    ),
    max_size=8,
)


def act(clock: PathClock, action: str | float) -> None:
    if action == "stop":
        clock.stop()
    elif action == "resume":
        clock.resume()
    else:
        assert isinstance(action, float)
        clock.override = action


@given(paths(), st.floats(0.1, 0.8), st.floats(0, 1), actions)
@examples(40)
def test_no_joint_exceeds_a_limit_whatever_happens(
    path: Path, margin: float, override: float, script: list[tuple[int, str | float]]
) -> None:
    limits = limits_with_margin(path, margin)
    assert first_violation(path, limits, CYCLE) is None
    clock = PathClock(path, limits, CYCLE, override=override, longest_stop=1e4)
    points, times = [path.start.positions] * 4, [0.0] * 4
    for cycles, action in [*script, (150, "stop")]:
        for _ in range(cycles):
            point = clock.advance(CYCLE)
            assert point.positions == path.at(clock.time).positions  # on the path, exactly
            points.append(point.positions)
            times.append(clock.time)
        act(clock, action)
    points += [clock.advance(CYCLE).positions for _ in range(50)]
    assert all(later >= earlier for earlier, later in itertools.pairwise(times))  # never back
    for joint, own in enumerate(limits):
        for seen in differences([each[joint] for each in points]):
            for each, limit, rounding in zip(seen, (own.speed, own.acceleration, own.jerk), (1e-12, 1e-9, 1e-6), strict=True):
                assert limit is not None
                assert each <= limit * (1 + ROUNDING) + rounding


@given(paths(), st.floats(0.1, 0.8), st.integers(0, 600), st.sampled_from([0.0, 0.3, 1.0]))
@examples(40)
def test_a_stop_is_over_when_it_says(path: Path, margin: float, cycles: int, then: float) -> None:
    clock = PathClock(path, limits_with_margin(path, margin), CYCLE, longest_stop=1e4)
    for number in range(cycles):
        clock.advance(CYCLE)
        if number == cycles // 2:
            clock.override = then
    named = clock.stop()
    assert named <= clock.stop_time * (1 + 1e-9)
    clock.advance(named * (1 + 1e-12))
    assert (clock.is_at_rest, clock.rate) == (True, 0.0)
    stands = clock.advance(CYCLE)
    assert stands.velocities == stands.accelerations == [0.0] * path.joints
    assert clock.advance(CYCLE).positions == stands.positions
    assert clock.stop() == 0.0
    clock.override = 1.0  # a stop outlasts an override
    assert clock.advance(CYCLE).positions == stands.positions
    clock.resume()
    clock.advance(path.duration + 2 * clock.stop_time)
    assert (clock.is_finished, clock.time) == (True, path.duration)
    assert clock.advance(CYCLE).positions == path.end.positions


def stepwise(jerks: list[tuple[float, float]], order: int) -> list[Segment]:
    """One joint's row from rest: durations, and what is constant in each, the derivative of this order."""
    row, state = [], [0.0] * order
    for duration, constant in jerks:
        own = [*state, constant]
        row.append(Segment(duration, tuple([each / math.factorial(number) for number, each in enumerate(own)])))
        state = [
            sum(own[lower] * duration ** (lower - number) / math.factorial(lower - number) for lower in range(number, order + 1))
            for number in range(order)
        ]
    return row


HARD_TO_STOP_ON = {
    "speed 1 in 1 s, and back to rest": (
        [stepwise([(1.0, 1.0), (1.5, 0.0), (1.0, -1.0)], 2)],
        [JointLimits(speed=1.0, acceleration=1.25)],
    ),
    "the same with its jerk limited": (
        [stepwise([(0.5, 2.0), (0.5, 0.0), (0.5, -2.0), (1.5, 0.0), (0.5, -2.0), (0.5, 0.0), (0.5, 2.0)], 3)],
        [JointLimits(speed=1.0, acceleration=1.25, jerk=2.5)],
    ),
    "the same with a jerk that is ample": (
        [stepwise([(0.5, 2.0), (0.5, 0.0), (0.5, -2.0), (1.5, 0.0), (0.5, -2.0), (0.5, 0.0), (0.5, 2.0)], 3)],
        [JointLimits(speed=1.0, acceleration=1.25, jerk=20.0)],
    ),
    "two joints, of which one rests in between": (
        [
            stepwise([(0.5, 4.0), (0.5, -4.0), (1.0, 0.0), (0.5, -4.0), (0.5, 4.0)], 3),
            stepwise([(0.5, 4.0), (1.0, -4.0), (0.5, 4.0), (0.5, -8.0), (0.5, 8.0)], 3),
        ],
        [JointLimits(acceleration=3.0, jerk=6.0), JointLimits(acceleration=5.0, jerk=12.0)],
    ),
    "corners": (
        [[Segment(1.0, (0.0, 1.0)), Segment(1.0, (1.0, 1.01)), Segment(20.0, (2.01, 1.0))]],
        [JointLimits(acceleration=2.6, jerk=700.0)],
    ),
}


@pytest.mark.thorough(3)
@pytest.mark.parametrize("case", HARD_TO_STOP_ON)
def test_a_stop_keeps_the_limits_wherever_it_begins(case: str) -> None:
    rows, limits = HARD_TO_STOP_ON[case]
    path = Path(rows)
    assert first_violation(path, limits, CYCLE) is None
    for begin in (*range(5, min(int(path.duration / CYCLE), 900), 29), 249, 250, 251, 499, 500, 501):  # around knots, too
        clock = PathClock(path, limits, CYCLE, moving=True, longest_stop=20.0)
        points = [clock.advance(begin * CYCLE - 4 * CYCLE).positions, *(clock.advance(CYCLE).positions for _ in range(4))]
        points += [clock.advance(CYCLE).positions for _ in range(math.ceil(clock.stop() / CYCLE) + 3)]
        assert clock.is_at_rest
        for joint, own in enumerate(limits):
            for seen in differences([each[joint] for each in points]):
                for each, limit in zip(seen, (own.speed, own.acceleration, own.jerk), strict=True):
                    assert limit is None or each <= limit * (1 + ROUNDING) + 1e-6


@st.composite
def plans(draw: st.DrawFn) -> Path:
    """One to three joints that go once or twice, each time in seven phases of constant jerk, as a plan does."""
    rows: list[list[Segment]] = [[] for _ in range(draw(st.integers(1, 3)))]
    ends = [0.0] * len(rows)
    for _ in range(draw(st.integers(1, 2))):
        jerked, even, cruise = (draw(st.integers(least, most)) / 100 for least, most in ((5, 30), (1, 50), (1, 80)))
        for joint, row in enumerate(rows):
            jerk = draw(st.integers(-10, 10))
            way = stepwise([(jerked, jerk), (even, 0.0), (jerked, -jerk), (cruise, 0.0)], 3)
            way = stepwise(
                [(each.duration, 6 * each.coefficients[3]) for each in way]
                + [(jerked, -jerk), (even, 0.0), (jerked, jerk)], 3
            )  # fmt: skip
            row += [Segment(each.duration, (each.coefficients[0] + ends[joint], *each.coefficients[1:])) for each in way]
            ends[joint] = sum(each * row[-1].duration ** number for number, each in enumerate(row[-1].coefficients))
    return Path(rows)


@given(
    st.one_of(paths(), plans()), st.floats(0.1, 0.6), st.sampled_from([0.2, 0.7, 1.0]), st.booleans(), st.integers(0, 700),
    st.sampled_from([0.0, 0.4, 1.0]), st.integers(0, 60), st.booleans(),
)  # fmt: skip
@examples(60)
def test_a_stop_at_any_moment_keeps_the_limits(
    path: Path, margin: float, override: float, moving: bool, cycles: int, then: float, later: int, goes_on: bool
) -> None:
    limits = limits_with_margin(path, margin)
    moving = moving and not PathClock(path, limits, CYCLE, longest_stop=1e4).stop_time > path.duration
    clock = PathClock(path, limits, CYCLE, override=override, moving=moving, longest_stop=1e4)
    clock.advance(cycles * CYCLE)
    clock.override = then  # the rate grows or falls when the stop begins
    points = [clock.advance(CYCLE).positions for _ in range(later + 4)]
    named = clock.stop()
    assert named <= clock.stop_time * (1 + 1e-9)
    most = min(math.ceil(named / CYCLE), 1500)
    for number in range(most + 3):
        points.append(clock.advance(CYCLE).positions)
        if goes_on and number == most // 2:
            clock.resume()
            clock.override = 1.0
    points += [clock.advance(CYCLE).positions for _ in range(30)]
    for joint, own in enumerate(limits):
        for seen in differences([each[joint] for each in points]):
            for each, limit, rounding in zip(seen, (own.speed, own.acceleration, own.jerk), (1e-12, 1e-9, 1e-6), strict=True):
                assert limit is not None
                assert each <= limit * (1 + ROUNDING) + rounding * (1 + max(abs(p[joint]) for p in points))


def test_a_stop_takes_little_longer_than_the_ramp_of_the_joint() -> None:
    speed, limits = 90.0, [JointLimits(speed=90.0, acceleration=180.0, jerk=1800.0)]
    jerk, acceleration = 0.8 * 1800.0, 0.8 * 180.0  # a plan with its margin
    even, jerked = speed / acceleration - acceleration / jerk, acceleration / jerk
    up, down = [(jerked, jerk), (even, 0.0), (jerked, -jerk)], [(jerked, -jerk), (even, 0.0), (jerked, jerk)]
    path = Path([stepwise([*up, (0.5, 0.0), *down], 3)])
    ramp = speed / 180.0 + 180.0 / 1800.0
    stops = []
    for cycles in range(1, int(path.duration / 0.01), 3):
        clock = PathClock(path, limits, 0.01)
        clock.advance(cycles * 0.01)
        stops.append(clock.stop())
    assert max(stops) < 2.4 * ramp
    assert sum(stops) / len(stops) < 1.1 * ramp
    assert not clock.is_finished
    clock.advance(stops[-1])  # near its end, the end of the path is the stop
    assert clock.is_finished


@pytest.mark.thorough(2)
@pytest.mark.parametrize("override", [1.0, 0.9])
def test_a_stop_while_joints_gather_speed_is_over_sooner_if_it_begins_behind_that(override: float) -> None:
    rows = []
    for jerk in (720.0, 288.0, 20.0):
        up = [(0.25, jerk), (0.125, 0.0), (0.25, -jerk)]
        rows.append(stepwise([*up, (1.5, 0.0), *((lasts, -each) for lasts, each in up)], 3))
    path = Path(rows)
    limits = limits_with_margin(path, 0.2)
    sooner = 0
    for cycles in range(5, 400, 6):
        clock = PathClock(path, limits, CYCLE, override=override)
        points = [path.start.positions] * 4 + [clock.advance(CYCLE).positions for _ in range(cycles)]
        margin, here = clock._margin, clock.time
        at_once = margin.braking_at(here, override, 0.0)
        lasts = rest_time(at_once, path.duration - here)
        named = clock.stop()
        assert named <= lasts
        points += [clock.advance(CYCLE).positions for _ in range(math.ceil(named / CYCLE))]
        assert clock.is_at_rest
        assert clock.time <= here + at_once.at(lasts)[0] + 1e-9  # no further on the path, either
        sooner += named < 0.8 * lasts
        for joint, own in enumerate(limits):
            for seen in differences([each[joint] for each in points]):
                for each, limit in zip(seen, (own.speed, own.acceleration, own.jerk), strict=True):
                    assert limit is None or each <= limit * (1 + ROUNDING) + 1e-6
    assert sooner > 5


@pytest.mark.parametrize("rate", [1.0, 0.3, 0.05])
def test_a_stop_that_would_be_too_long_is_not_searched_and_any_other_one_is_the_same(rate: float) -> None:
    rows = [
        stepwise([(0.25, jerk), (0.125, 0.0), (0.25, -jerk), (1.5, 0.0), (0.25, -jerk), (0.375, jerk)], 3) for jerk in (72, 20)
    ]
    path = Path(rows)
    margin = PathClock(path, limits_with_margin(path, 0.2), CYCLE)._margin
    cut_off = 0
    for number in range(40):
        time = path.duration * number / 40
        meant = margin.braking_at(time, rate, 0.0)
        for worth in (0.5 * meant.duration, 0.9 * meant.duration, meant.duration, 1.1 * meant.duration):
            found = margin.braking_at(time, rate, 0.0, None, worth)
            if meant.duration <= worth:
                assert found.phases == meant.phases
            else:
                assert found.duration > worth
                cut_off += found.phases != meant.phases
    assert cut_off > 5


def test_a_stop_at_a_constant_speed_may_use_all_of_the_acceleration() -> None:
    rows, limits = HARD_TO_STOP_ON["speed 1 in 1 s, and back to rest"]
    clock = PathClock(Path(rows), limits, CYCLE)
    clock.advance(1.2)
    assert clock.stop() < 1.0  # 1 / 1.25 s, and some for the onset; the margin alone would need 4 s
    assert clock.stop_time > 4.0
    clock = PathClock(Path(rows), limits, CYCLE)
    clock.advance(0.2)  # it gathers speed: braking takes that away first
    assert clock.stop() < 0.5


def test_joints_that_have_stopped_by_themselves_start_again_from_rest() -> None:
    clock = PathClock(MOVING_ENDS, limits_with_margin(MOVING_ENDS, 0.4), CYCLE)
    while not clock.is_finished:  # also while it brakes for the end
        clock.advance(CYCLE)
        if 1.0 < clock.time < 1.01 or 2.49 < clock.time < 2.495:
            here = clock.time
            clock.after_gap()
            assert (clock.rate, clock.time) == (0.0, here)
            clock.advance(0.5)
            assert clock.time > here
    clock.after_gap()
    assert clock.is_finished
    clock = PathClock(MOVING_ENDS, limits_with_margin(MOVING_ENDS, 0.4), CYCLE)
    clock.advance(1.0)
    clock.stop()
    clock.after_gap()
    assert clock.is_at_rest
    clock.advance(CYCLE)
    assert clock.rate == 0.0


def test_a_stop_that_is_taken_back_is_over_first() -> None:
    rows, limits = HARD_TO_STOP_ON["speed 1 in 1 s, and back to rest"]
    clock = PathClock(Path(rows), limits, CYCLE)
    clock.advance(1.2)
    named = clock.stop()
    clock.advance(0.1)
    clock.resume()
    assert not clock.is_stopping
    clock.advance(named - 0.05)
    here = clock.time
    clock.advance(CYCLE)
    assert clock.time > here
    again = clock.stop()
    assert clock.stop() == again


@pytest.mark.parametrize("path", [REST_TO_REST, MOVING_ENDS])
def test_velocities_and_accelerations_are_those_of_the_positions(path: Path) -> None:
    clock = PathClock(path, limits_with_margin(path, 0.4), CYCLE)
    dt = 1e-5
    for number in range(300):
        if number in (50, 180):
            clock.stop()
        elif number == 140:
            clock.resume()
        point = clock.advance(CYCLE)
        near, far = clock.advance(dt), clock.advance(dt)
        for joint in range(path.joints):
            p, q, r = point.positions[joint], near.positions[joint], far.positions[joint]
            assert near.velocities[joint] == pytest.approx((r - p) / (2 * dt), abs=1e-6)
            assert near.accelerations[joint] == pytest.approx((r - 2 * q + p) / dt**2, abs=1e-3)


def test_a_path_from_rest_to_rest_is_followed_as_planned() -> None:
    clock = PathClock(REST_TO_REST, limits_with_margin(REST_TO_REST, 0.2), CYCLE)
    for number in range(1, 625):
        assert clock.advance(CYCLE).positions == pytest.approx(REST_TO_REST.at(number * CYCLE).positions)
    assert not clock.is_finished
    assert clock.advance(CYCLE).positions == REST_TO_REST.end.positions
    assert (clock.is_finished, clock.is_at_rest, clock.rate) == (True, True, 0.0)


def test_half_speed_from_the_start_takes_twice_the_time() -> None:
    clock = PathClock(REST_TO_REST, limits_with_margin(REST_TO_REST, 0.2), CYCLE, override=0.5)
    assert clock.advance(1.0) == (
        REST_TO_REST.at(0.5).positions,
        [0.5 * each for each in REST_TO_REST.at(0.5).velocities],
        [0.25 * each for each in REST_TO_REST.at(0.5).accelerations],
    )
    clock.advance(3.999)
    assert not clock.is_finished
    clock.advance(0.001)
    assert clock.is_finished


def test_a_path_that_starts_and_ends_in_motion_is_run_from_rest_to_rest() -> None:
    clock = PathClock(MOVING_ENDS, limits_with_margin(MOVING_ENDS, 0.4), CYCLE)
    assert (clock.rate, clock.advance(0.0).velocities) == (0.0, [0.0])
    clock.advance(1.0)
    assert clock.rate == pytest.approx(1.0)
    while not clock.is_finished:
        point = clock.advance(CYCLE)
    assert (point.positions, point.velocities) == (MOVING_ENDS.end.positions, [0.0])


def test_a_blend_goes_on_from_the_motion_that_is_there() -> None:
    clock = PathClock(MOVING_ENDS, limits_with_margin(MOVING_ENDS, 0.4), CYCLE, moving=True)
    assert (clock.rate, clock.advance(0.0)) == (1.0, MOVING_ENDS.start)
    clock.override = 0.5
    assert clock.rate == 1.0  # slows down, does not jump
    clock.advance(1.0)
    assert clock.rate == 0.5


def test_a_path_that_is_too_short_to_brake_on_starts_from_rest_or_not_at_all() -> None:
    path = Path([[Segment(0.2, (0.0, 1.0))]])  # 1 per second, on and on
    limits = [JointLimits(acceleration=1.0)]
    with pytest.raises(PathError, match="takes 0.2 s and ends in motion"):
        PathClock(path, limits, CYCLE, moving=True)
    clock = PathClock(path, limits, CYCLE)
    positions = [0.0] * 4
    while not clock.is_finished:
        positions += clock.advance(CYCLE).positions
    assert positions[-1] == path.end.positions[0]
    assert max(acceleration for _, acceleration, _ in differences(positions)) <= 1.0 + ROUNDING


def test_an_override_of_0_is_a_pause_on_the_path() -> None:
    clock = PathClock(REST_TO_REST, limits_with_margin(REST_TO_REST, 0.4), CYCLE)
    clock.advance(0.5)
    clock.override = 0.0
    clock.advance(clock.stop_time)
    assert (clock.is_at_rest, clock.is_finished, clock.is_stopping) == (True, False, False)
    here = clock.time
    clock.advance(60.0)
    assert clock.time == here
    clock.override = 1.0
    assert not clock.is_at_rest
    clock.advance(10.0)
    assert clock.is_finished


def test_without_limits_a_stop_still_takes_its_time() -> None:
    clock = PathClock(REST_TO_REST, [JointLimits()] * 2, CYCLE)
    clock.advance(1.0)
    assert clock.stop() == pytest.approx(0.1)
    assert clock.stop_time <= 0.2


def test_a_line_with_a_corner_leaves_free_what_a_cycle_sees_of_it() -> None:
    path = Path([[Segment(1.0, (0.0, 1.0)), Segment(1.0, (1.0, 1.01))]])  # 0.01 per second over 4 ms: 2.5 per second²
    clock = PathClock(path, [JointLimits(acceleration=4.0)], CYCLE)
    assert clock.stop_time == pytest.approx(1.01 / 1.5, rel=0.2)
    with pytest.raises(
        PathError, match=r"nothing free for a stop along it. Joint 0 needs the acceleration 2.5 at 1 s of the path"
    ):
        PathClock(path, [JointLimits(acceleration=2.5)], CYCLE)


@pytest.mark.parametrize(
    ("limits", "text"),
    [
        ([JointLimits()], "The path has 2 joints, but there are limits for 1"),
        ([JointLimits(), JointLimits(jerk=1.0)], "nothing free for a stop along it. Joint 1 needs the jerk 11.52 at"),
        ([JointLimits(), JointLimits(jerk=12.0)], "may take 23.5 s, and 5 s are allowed. Joint 1 needs the jerk 11.52"),
    ],
)
def test_a_path_that_cannot_be_stopped_on_is_refused(limits: list[JointLimits], text: str) -> None:
    with pytest.raises(PathError, match=text):
        PathClock(REST_TO_REST, limits, CYCLE, longest_stop=5.0)


def test_a_path_stretched_a_little_can_be_stopped_on() -> None:
    limits = limits_with_margin(REST_TO_REST, 0.0)
    with pytest.raises(PathError, match="Try: the path `stretched`"):
        PathClock(REST_TO_REST, limits, CYCLE)
    assert PathClock(REST_TO_REST.stretched(1.2), limits, CYCLE).stop_time < 3.2


@pytest.mark.parametrize("override", [-0.1, 1.1, math.nan])
def test_an_override_outside_0_to_1_changes_nothing(override: float) -> None:
    clock = PathClock(REST_TO_REST, [JointLimits()] * 2, CYCLE)
    with pytest.raises(PathError, match="from 0 .* to 1"):
        clock.override = override
    assert clock.override == 1.0
    with pytest.raises(PathError, match="cannot go on by"):
        clock.advance(-1.0)
    with pytest.raises(PathError, match="A cycle takes 0.0 s"):
        PathClock(REST_TO_REST, [JointLimits()] * 2, 0.0)


@given(st.integers(1, 600), st.sampled_from(["", "stop", "half"]))
@examples(20)
def test_behind_a_gap_the_path_goes_on_from_rest_where_it_is(cycles: int, before: str) -> None:
    limits = limits_with_margin(REST_TO_REST, 0.2)
    clock = PathClock(REST_TO_REST, limits, CYCLE)
    for _ in range(cycles):
        clock.advance(CYCLE)
    if before:
        act(clock, "stop" if before == "stop" else 0.5)
        clock.advance(CYCLE)
    here, positions = clock.time, clock.advance(0.0).positions
    clock.after_gap()
    assert clock.rate == 0
    assert (clock.time, clock.advance(0.0).positions) == (here, positions)
    after = [clock.advance(CYCLE).positions for _ in range(40)]
    for joint, own in enumerate(limits):  # the joints stood before
        for _, acceleration, jerk in differences([positions[joint]] * 3 + [each[joint] for each in after]):
            assert acceleration <= (own.acceleration or 0) * (1 + ROUNDING)
            assert jerk <= (own.jerk or 0) * (1 + ROUNDING)
    if before == "stop":
        assert clock.is_at_rest
    else:
        clock.advance(20.0)
        assert clock.is_finished
