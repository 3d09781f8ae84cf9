"""Paths from waypoints and functions: what they pass, what is continuous, and what they reproduce exactly."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.drives.trajectory import Path, PathError, cubic, from_function, linear, quintic
from canopen_proto.drives.trajectory.path import PathPoint
from tests.builds import takes_any_type
from tests.examples import examples

value = st.floats(-10, 10)
triple = st.tuples(value, value, value)


@st.composite
def waypoints(draw: st.DrawFn) -> tuple[list[float], list[tuple[list[float], list[float], list[float]]]]:
    """Times, and for each of them the positions, velocities and accelerations of two joints."""
    steps = draw(st.lists(st.floats(0.05, 5), min_size=1, max_size=6))
    times = list(itertools.accumulate(steps, initial=draw(st.floats(-3, 3))))
    rows = [draw(st.tuples(triple, triple)) for _ in times]
    return times, [tuple(map(list, zip(*row, strict=True))) for row in rows]  # type: ignore[misc]


def sides(path: Path, time: float) -> tuple[PathPoint, PathPoint]:
    """The points just before and just after a knot."""
    tiny = 1e-11
    return path.at(time - tiny), path.at(time + tiny)


@given(waypoints())
@examples(40)
def test_each_path_passes_what_was_given(
    given_points: tuple[list[float], list[tuple[list[float], list[float], list[float]]]],
) -> None:
    times, rows = given_points
    positions, velocities, accelerations = (list(each) for each in zip(*rows, strict=True))
    for path, orders in (
        (linear(times, positions), 1),
        (cubic(times, positions), 1),
        (cubic(times, positions, natural=True), 1),
        (cubic(times, positions, velocities), 2),
        (quintic(times, positions, velocities, accelerations), 3),
    ):
        assert path.duration == pytest.approx(times[-1] - times[0])
        for time, row in zip(times, rows, strict=True):
            for side in sides(path, time - times[0]):
                for order in range(orders):
                    assert side[order] == pytest.approx(row[order], abs=1e-3)


@given(waypoints(), st.booleans())
@examples(40)
def test_a_spline_jumps_in_no_acceleration_and_ends_as_it_should(
    given_points: tuple[list[float], list[tuple[list[float], list[float], list[float]]]], natural: bool
) -> None:
    times, rows = given_points
    path = cubic(times, [row[0] for row in rows], natural=natural)
    for time in times[1:-1]:
        before, after = sides(path, time - times[0])
        assert before.velocities == pytest.approx(after.velocities, rel=1e-4, abs=1e-4)
        assert before.accelerations == pytest.approx(after.accelerations, rel=1e-4, abs=1e-3)
    for end in (path.start, path.end):
        assert (end.accelerations if natural else end.velocities) == pytest.approx([0.0, 0.0], abs=1e-8)


def test_from_rest_to_rest_by_hand() -> None:
    path = cubic([5.0, 7.0], [[0.0], [8.0]])  # 8 (3 u² - 2 u³) with u = t / 2
    assert path.at(0.5) == PathPoint([pytest.approx(1.25)], [pytest.approx(4.5)], [pytest.approx(6.0)])  # type: ignore[list-item]
    path = quintic([0.0, 2.0], [[0.0], [8.0]], [[0.0], [0.0]], [[0.0], [0.0]])  # 8 (10 u³ - 15 u⁴ + 6 u⁵)
    assert path.at(1.0) == PathPoint([pytest.approx(4.0)], [pytest.approx(7.5)], [pytest.approx(0.0)])  # type: ignore[list-item]


def test_a_cubic_function_is_reproduced_exactly() -> None:
    def function(t: float) -> list[float]:
        return [1 + 2 * t - t**2 + 0.5 * t**3, 3.0]

    path = from_function(function, 2.0, 0.3)
    assert len(path.segments[0]) == 7  # steps of 2/7 s, no longer than asked for
    for time in (0.0, 0.111, 1.0, 1.9, 2.0):
        assert path.at(time).positions == pytest.approx(function(time))
        assert path.at(time).accelerations == pytest.approx([-2 + 3 * time, 0.0], abs=1e-9)


def test_the_error_of_a_function_falls_with_the_fourth_power_of_the_step() -> None:
    def error(step: float) -> float:
        path = from_function(lambda t: [math.sin(t)], 6.0, step)
        return max(abs(path.at(t / 100).positions[0] - math.sin(t / 100)) for t in range(601))

    assert error(0.1) < 2e-5
    assert error(0.05) < error(0.1) / 12


def test_a_step_that_divides_the_duration_but_for_rounding_is_kept() -> None:
    assert len(from_function(lambda t: [t], 0.3, 0.1).segments[0]) == 3
    assert len(from_function(lambda t: [t], 0.1, 0.1).segments[0]) == 3  # at least three


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: linear([0.0], [[1.0]]), "at least two waypoints; there are 1"),
        (lambda: linear([0.0, 0.0], [[1.0], [2.0]]), r"waypoint 1 \(counted from 0\) is at 0.0 s, the one before at 0.0 s"),
        (lambda: linear([0.0, math.nan], [[1.0], [2.0]]), "waypoint 1 .* is at nan s"),
        (lambda: cubic([0.0, 1.0], [[1.0]]), "2 times, but 1 rows of positions"),
        (lambda: cubic([0.0, 1.0], [[1.0], [1.0, 2.0]]), r"Row 1 \(counted from 0\) of the positions has 2 values. Try: 1"),
        (lambda: cubic([0.0, 1.0], [[1.0], [1.0]], [[1.0, 2.0], [0.0, 0.0]]), "Row 0 .* of the velocities has 2 values. Try: 1"),
        (lambda: quintic([0.0, 1.0], [[1.0], [1.0]], [[1.0], [2.0]], []), "2 times, but 0 rows of accelerations"),
        (lambda: linear([0.0, 1.0], [[1.0], [math.inf]]), "no finite number"),
        pytest.param(
            lambda: cubic([0.0, 1.0], [[1.0], [10**5000]]), "Row 1 .* has a value that is no finite number", marks=takes_any_type
        ),
        (lambda: cubic([0.0, 0.001, 1.0], [[0.0], [1e307], [0.0]]), "Row 1 .* has a value that is no finite number"),
        pytest.param(
            lambda: linear([0, 10**5000], [[1.0], [2.0]]),
            "waypoint 1 .* is at a whole number of 16610 bits s",
            marks=takes_any_type,
        ),
        (lambda: quintic([0.0, 1e70], *[[[0.0], [0.0]]] * 3), "waypoint 1 .* is at 1e"),
        (lambda: from_function(lambda t: [t], 1.0, 0.0), "cannot have steps of 0.0 s"),
        (lambda: from_function(lambda t: [t], 1.0, 1e-9), "at most 1,000,000 steps"),
        (lambda: linear([0.0, 1.0], [[], []]), "at least one joint"),
    ],
)
def test_waypoints_that_make_no_path(make: Callable[[], Path], text: str) -> None:
    with pytest.raises(PathError, match=text):
        make()
