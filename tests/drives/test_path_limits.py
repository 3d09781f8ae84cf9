"""Where a path exceeds a limit first. The oracle: the same path at many times, and the difference quotients of its positions."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.drives.trajectory import JointLimits, Path, PathError, Segment, cubic, first_violation, linear
from canopen_proto.drives.trajectory.limit_check import LimitViolation, reach_of
from canopen_proto.drives.trajectory.polynomial import extremes_of, roots_of, value_at
from tests.drives.paths import CYCLE, differences, limits_with_margin, through
from tests.examples import examples

numbers = st.floats(-10, 10)
ROUNDING = 1e-9
PEAK = Path([[Segment(2.0, (1.0,))], through([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], [2.0])])
"""The second joint goes from 0 to 1 in 2 s: speed 15/16 at 1 s, acceleration 5/2/sqrt(3), jerk 7.5 at the ends."""


@given(st.lists(numbers, min_size=1, max_size=6), st.floats(0.1, 5))
@examples(80)
def test_extremes_are_those_of_many_samples(coefficients: list[float], duration: float) -> None:
    low, low_time, high, high_time = extremes_of(coefficients, duration)
    samples = [value_at(coefficients, duration * number / 300) for number in range(301)]
    assert low <= min(samples) + ROUNDING
    assert max(samples) <= high + ROUNDING
    assert (value_at(coefficients, low_time), value_at(coefficients, high_time)) == (low, high)
    slope = max(abs(b - a) for a, b in itertools.pairwise(samples))
    assert min(samples) - low <= slope + ROUNDING
    assert high - max(samples) <= slope + ROUNDING


@given(st.lists(st.floats(0.05, 0.95), min_size=1, max_size=4, unique_by=lambda each: round(each, 1)))
@examples(60)
def test_roots_are_found_where_they_were_put(roots: list[float]) -> None:
    coefficients = [1.0]
    for root in roots:  # times (t - root)
        coefficients = [b - root * a for a, b in zip([*coefficients, 0.0], [0.0, *coefficients], strict=True)]
    assert roots_of(coefficients, 1.0) == pytest.approx(sorted(roots), abs=1e-6)


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ({}, None),
        ({"lowest": 0.0, "highest": 1.0, "speed": 0.9375, "acceleration": 2.5 / math.sqrt(3), "jerk": 7.5}, None),
        ({"speed": 0.93}, LimitViolation(1, 1.0, "speed", 0.9375, 0.93)),
        ({"highest": 0.9}, LimitViolation(1, 2.0, "position", 1.0, 0.9)),
        ({"lowest": 0.1}, LimitViolation(1, 0.0, "position", 0.0, 0.1)),
        ({"acceleration": 1.4}, LimitViolation(1, 1 - 1 / math.sqrt(3), "acceleration", 2.5 / math.sqrt(3), 1.4)),
        ({"jerk": 7.0}, LimitViolation(1, 0.0, "jerk", 7.5, 7.0)),
        ({"speed": 0.5, "highest": 0.9}, LimitViolation(1, 1.0, "speed", 0.9375, 0.5)),
        ({"speed": math.inf, "jerk": math.inf}, None),
    ],
)
def test_the_first_violation_names_joint_time_value_and_limit(limits: dict[str, float], expected: LimitViolation | None) -> None:
    found = first_violation(PEAK, [JointLimits(speed=1.0), JointLimits(**limits)], CYCLE)
    assert (found is None) is (expected is None)
    if found is not None and expected is not None:
        assert (found.joint, found.kind, found.limit) == (expected.joint, expected.kind, expected.limit)
        assert (found.time, found.value) == pytest.approx((expected.time, expected.value), abs=1e-9)


def test_how_far_a_joint_goes() -> None:
    assert reach_of(PEAK, 1) == (0.0, pytest.approx(1.0))
    assert reach_of(Path([[Segment(1.0, (0.0, 4.0, -4.0)), Segment(1.0, (0.0, -1.0))]]), 0) == (-1.0, 1.0)


def test_a_violation_in_words() -> None:
    found = first_violation(PEAK, [JointLimits(), JointLimits(speed=0.5)], CYCLE)
    assert str(found) == "joint 1 at 1 s: speed 0.9375, limit 0.5"


def test_a_jump_of_the_velocity_is_one_of_a_cycle() -> None:
    path = linear([0.0, 1.0, 2.0], [[0.0], [1.0], [3.0]])
    assert first_violation(path, [JointLimits(speed=2.0, acceleration=250.0)], CYCLE) is None
    found = first_violation(path, [JointLimits(acceleration=249.0)], CYCLE)
    assert found is not None
    assert found == LimitViolation(0, 1.0, "acceleration", pytest.approx(250.0), 249.0)  # type: ignore[arg-type]
    found = first_violation(path, [JointLimits(jerk=62_000.0)], CYCLE)
    assert found is not None
    assert found == LimitViolation(0, 1.0, "jerk", pytest.approx(62_500.0), 62_000.0)  # type: ignore[arg-type]
    row = [path.at(number * CYCLE).positions[0] for number in range(501)]
    assert max(acceleration for _, acceleration, _ in differences(row)) == pytest.approx(250.0)  # as a drive sees it
    assert max(jerk for _, _, jerk in differences(row)) == pytest.approx(62_500.0)


def test_a_jump_of_the_acceleration_is_a_jerk_of_a_cycle() -> None:
    path = cubic([0.0, 1.0, 2.0], [[0.0], [1.0], [0.0]], [[0.0], [0.0], [0.0]])  # stops with -6, goes on with -6: no jump
    assert first_violation(path, [JointLimits(acceleration=6.0, jerk=12.0)], CYCLE) is None
    path = cubic([0.0, 1.0, 2.0], [[0.0], [1.0], [2.0]], [[0.0], [0.0], [0.0]])  # -6, then +6
    found = first_violation(path, [JointLimits(acceleration=6.0, jerk=12.0)], CYCLE)
    assert found is not None
    assert (found.kind, found.time) == ("jerk", 1.0)
    assert found.value == pytest.approx(12 / CYCLE + 12)


@given(
    st.lists(st.tuples(numbers, numbers), min_size=2, max_size=5),
    st.sampled_from(["linear", "spline", "hermite"]),
    st.sampled_from([0.001, 0.004, 0.01]),
)
@examples(40, least=8)
def test_what_passes_the_check_is_within_the_limits_for_a_drive(
    points: list[tuple[float, float]], kind: str, cycle_time: float
) -> None:
    times = [0.2 * number for number in range(len(points))]
    positions, velocities = [[p] for p, _ in points], [[v] for _, v in points]
    path = (
        linear(times, positions)
        if kind == "linear"
        else cubic(times, positions, velocities if kind == "hermite" else None, natural=True)
    )
    (own,) = limits_with_margin(path, 0.0, cycle_time)
    assert first_violation(path, [own], cycle_time) is None
    assert own.jerk is not None
    tight = first_violation(path, [replace(own, jerk=own.jerk * 0.99)], cycle_time)
    assert tight is None or tight.kind == "jerk"
    row = [path.at(0.37 * cycle_time + number * cycle_time).positions[0] for number in range(int(path.duration / cycle_time))]
    for seen in differences(row, cycle_time):
        for each, limit in zip(seen, (own.speed, own.acceleration, own.jerk), strict=True):
            assert limit is not None
            assert each <= limit * (1 + 1e-9) + 1e-13 / cycle_time**3


def test_arguments_that_do_not_fit() -> None:
    with pytest.raises(PathError, match="The path has 2 joints, but there are limits for 1"):
        first_violation(PEAK, [JointLimits()], CYCLE)
    with pytest.raises(PathError, match="A cycle takes nan s"):
        first_violation(PEAK, [JointLimits(), JointLimits()], math.nan)
