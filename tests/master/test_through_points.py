"""Paths through waypoints without times: exactly through them, within the limits, faster than with stops."""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import pytest

from canopen_master.errors import PlanRefusedError
from canopen_master.trajectories.point_to_point import MARGIN
from canopen_master.trajectories.through_points import through_points
from canopen_proto.drives.trajectory import JointLimits, Path, PathClock, first_violation
from tests.master.path_extremes import assert_keeps, extremes

LIMITS = JointLimits(-90.0, 90.0, 100.0, 400.0, 4000.0)
CIRCLE = [[50.0 * math.cos(turn / 8.0 * math.tau), 50.0 * math.sin(turn / 8.0 * math.tau)] for turn in range(9)]


def assert_passes(path: Path, points: Sequence[Sequence[float]]) -> None:
    """All joints have a knot at each point, in order, and the path rests at both ends."""
    knots = iter([*([row.coefficients[0] for row in rows] for rows in zip(*path.segments, strict=True)), path.end.positions])
    for point in points:
        assert any(knot == pytest.approx(point, rel=1e-12, abs=1e-12) for knot in knots)
    for end in (path.start, path.end):
        assert end.velocities == pytest.approx([0.0] * path.joints, abs=1e-9)
        assert end.accelerations == pytest.approx([0.0] * path.joints, abs=1e-6)


def with_stops(points: Sequence[Sequence[float]], limits: JointLimits) -> float:
    """The least time with a stop at each point: its closed form for moves that reach full speed and full acceleration."""
    assert limits.speed is not None
    assert limits.acceleration is not None
    assert limits.jerk is not None
    acceleration, jerk = limits.acceleration * (1.0 - MARGIN), limits.jerk * (1.0 - MARGIN)
    ramp = limits.speed / acceleration + acceleration / jerk
    distances = [max(abs(q - p) for p, q in zip(before, after, strict=True)) for before, after in pairwise(points)]
    assert min(distances) >= limits.speed * ramp
    return sum(ramp + distance / limits.speed for distance in distances)


@pytest.mark.thorough(4)
@pytest.mark.parametrize("seed", range(6))
def test_any_points_are_passed_within_the_limits(seed: int) -> None:
    rng = random.Random(seed)
    limits = []
    for _ in range(rng.choice((1, 3))):
        speed = 10.0 ** rng.uniform(-4, 6)
        acceleration = speed / 10.0 ** rng.uniform(-1.5, 0.3)
        limits.append(JointLimits(speed=speed, acceleration=acceleration, jerk=acceleration / 10.0 ** rng.uniform(-1.5, 0)))
    points = [[rng.uniform(-1.0, 1.0) * each.speed for each in limits] for _ in range(rng.choice((2, 3, 6)))]  # type: ignore[operator]
    path = through_points(points, limits)
    assert_passes(path, points)
    assert_keeps(path, limits, MARGIN)


def test_a_circle_is_faster_than_with_stops_and_can_be_stopped_on() -> None:
    path = through_points(CIRCLE, [LIMITS] * 2)
    assert_passes(path, CIRCLE)
    assert_keeps(path, [LIMITS] * 2, MARGIN)
    assert path.duration < 5.0
    speeds = [math.hypot(*path.at(part / 20.0 * path.duration).velocities) for part in range(2, 19)]
    assert min(speeds) > 50.0  # no stop, nor nearly
    for part in range(100):
        assert math.hypot(*path.at(part / 100.0 * path.duration).positions) == pytest.approx(50.0, abs=2.0)
    assert first_violation(path, [LIMITS] * 2, 0.004) is None
    assert PathClock(path, [LIMITS] * 2, 0.004).stop_time < 2.0


def test_some_corners_are_taken_without_a_stop() -> None:
    points = [[0.0, -80.0], [70.0, -20.0], [-10.0, 30.0], [60.0, 85.0]]
    path = through_points(points, [LIMITS] * 2)
    assert_passes(path, points)
    assert path.duration < with_stops(points, LIMITS)


def test_two_points_are_a_straight_line_in_nearly_the_least_time() -> None:
    points = [[-80.0, 10.0], [80.0, 50.0]]
    path = through_points(points, [LIMITS] * 2)
    assert path.duration <= with_stops(points, LIMITS) * 1.1
    for part in range(11):
        x, y = path.at(part / 10.0 * path.duration).positions
        assert y == pytest.approx(10.0 + (x + 80.0) / 4.0, abs=1e-6)


def test_a_jerk_that_limits_nothing_costs_no_time() -> None:
    points = [[0.0, -80.0], [30.0, -60.0]]
    free = replace(LIMITS, jerk=4e6)
    path = through_points(points, [free] * 2)
    assert path.duration <= (0.3 + 100.0 / 320.0) * 1.02  # the ramps of acceleration alone


def test_a_part_of_the_speed() -> None:
    path = through_points(CIRCLE[:2], [LIMITS] * 2, speed_factor=0.3)
    assert max(extremes(path, joint).speed for joint in range(2)) == pytest.approx(30.0, rel=0.05)
    assert_passes(path, CIRCLE[:2])


def test_it_needs_no_ruckig(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ruckig", None)
    assert through_points([[0.0], [1.0]], [LIMITS]).end.positions == pytest.approx([1.0])


@pytest.mark.parametrize(
    ("points", "text", "joint"),
    [
        ([[1.0, 2.0]], "at least two points", None),
        ([], "at least two points", None),
        ([[1.0, 2.0], [3.0]], "one position in point 1 for each joint", None),
        ([[1.0, 2.0, 3.0], [3.0, 4.0, 5.0]], "one position", None),
        ([[1.0, 2.0], [3.0, math.nan]], "the position in point 1 of joint 1 is no finite number", 1),
        ([[1.0, 2.0], [5.0, 2.0], [5.0, 2.0]], "points 1 and 2 are the same", None),
        ([[1.0, 2.0], [1.0, 2.0 + 1e-7], [5.0, 2.0]], "points 0 and 1 are the same, or nearly", None),
        ([[1.0, 2.0], [95.0, 2.0]], "(?s)joint 0 would leave its limits.*highest is 90", 0),
        ([[0.0, 0.0], [30.0, 88.0], [60.0, 88.0], [85.0, 0.0]], "(?s)joint 1 would leave its limits.*closer together", 1),
    ],
)
def test_what_makes_no_path_is_refused(points: list[list[float]], text: str, joint: int | None) -> None:
    with pytest.raises(PlanRefusedError, match=text) as refused:
        through_points(points, [LIMITS] * 2)
    assert refused.value.joint == joint
