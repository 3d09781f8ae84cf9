"""A path: what its polynomials say, at any time; and what is no path."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.drives.trajectory import JointLimits, Path, PathError, PathPoint, Segment
from tests.builds import takes_any_type
from tests.examples import examples


def test_two_joints_with_knots_of_their_own() -> None:
    # joint 0: one parabola from rest; joint 1: rests for 1 s, then goes at 3 per second
    path = Path([[Segment(2.0, (1.0, 0.0, 0.5))], [Segment(1.0, (5.0,)), Segment(1.0, (5.0, 3.0))]])
    assert (path.joints, path.duration) == (2, 2.0)
    assert path.at(0.5) == PathPoint([1.125, 5.0], [0.5, 0.0], [1.0, 0.0])
    assert path.at(1.5) == PathPoint([2.125, 6.5], [1.5, 3.0], [1.0, 0.0])
    assert repr(path) == "<Path of 2 joints, 2 s>"


def test_at_a_knot_the_derivatives_are_those_of_what_begins() -> None:
    path = Path([[Segment(1.0, (0.0, 1.0)), Segment(1.0, (1.0, -1.0))]])
    assert path.at(1.0) == PathPoint([1.0], [-1.0], [0.0])
    assert path.at(math.nextafter(1.0, 0.0)).velocities == [1.0]


def test_time_beyond_either_end_is_that_end() -> None:
    path = Path([[Segment(2.0, (1.0, 0.0, 0.5))]])
    assert path.at(-3.0) == path.start == PathPoint([1.0], [0.0], [1.0])
    assert path.at(9.0) == path.end == PathPoint([3.0], [2.0], [1.0])


numbers = st.floats(-100, 100)


@given(st.lists(numbers, min_size=1, max_size=6), st.floats(0.01, 10), st.floats(0, 1))
@examples(60)
def test_any_polynomial_against_its_plain_sum(coefficients: list[float], duration: float, part: float) -> None:
    path = Path([[Segment(duration, tuple(coefficients))]])
    t = duration * part
    point = path.at(t)
    for order, values in enumerate(point):
        terms = [math.perm(k, order) * c * t ** (k - order) for k, c in enumerate(coefficients) if k >= order]
        assert values == [pytest.approx(math.fsum(terms), abs=1e-12 * (1 + sum(map(abs, terms))))]


def test_joints_that_end_within_rounding_end_together() -> None:
    tenths = [Segment(0.1, (float(number), 10.0)) for number in range(10)]
    path = Path([tenths, [Segment(1.0, (0.0, 10.0))]])
    assert path.duration == 1.0
    assert path.end.positions == [10.0, 10.0]


REST = Segment(1.0, (0.0,))


@pytest.mark.parametrize(
    ("joints", "text"),
    [
        ([], "at least one joint"),
        ([[REST], []], "Joint 1 of the path has no segment"),
        ([[Segment(0.0, (1.0,))]], "Segment 0 of joint 0, which begins at 0 s, has the duration 0.0"),
        ([[Segment(math.nan, (1.0,))]], "has the duration nan"),
        ([[REST, Segment(1.0, ())]], "Segment 1 of joint 0, which begins at 1 s, has 0 coefficients"),
        ([[Segment(1.0, (0.0,) * 7)]], "has 7 coefficients. Try: 1 to 6"),
        ([[Segment(1.0, (0.0, math.inf))]], r"no finite number up to 1e\+100: \(0.0, inf\)"),
        pytest.param(
            [[Segment(1.0, (0.0, 10**5000))]],
            r"no finite number up to 1e\+100: \(0.0, a whole number of 16610 bits\)",
            marks=takes_any_type,
        ),
        ([[REST], [Segment(1.0, (0.0, 1e307, -1e308))]], "Segment 0 of joint 1, which begins at 0 s, has a coefficient"),
        ([[Segment(1e30, (0.0, 0.0, 0.0, 0.0, 1e30))]], r"goes beyond 1e\+100"),
        ([[REST, Segment(1.0, (0.1,))]], "starts at 0.1, but the segment before ends at 0.0"),
        ([[REST], [REST, REST]], "joint 0 ends at 1 s, joint 1 at 2 s"),
    ],
)
def test_what_is_no_path_is_told_with_its_place(joints: list[list[Segment]], text: str) -> None:
    with pytest.raises(PathError, match=text):
        Path(joints)


def test_rounding_at_a_knot_is_no_jump() -> None:
    Path([[Segment(1.0, (1e6, 0.3)), Segment(1.0, (1e6 + 0.3 + 1e-3,))]])
    with pytest.raises(PathError, match="starts at"):
        Path([[Segment(1.0, (1e6, 0.3)), Segment(1.0, (1e6 + 0.32,))]])


@pytest.mark.parametrize(
    ("limits", "text"),
    [
        ({"lowest": 1.0, "highest": 1.0}, "below the highest"),
        ({"speed": 0.0}, "limit of the speed must be above 0"),
        ({"acceleration": -1.0}, "limit of the acceleration"),
        ({"jerk": math.nan}, "limit of the jerk"),
        ({"lowest": math.nan}, "below the highest"),
        ({"highest": math.nan}, "below the highest"),
    ],
)
def test_limits_that_allow_nothing_are_refused(limits: dict[str, float], text: str) -> None:
    with pytest.raises(PathError, match=text):
        JointLimits(**limits)
