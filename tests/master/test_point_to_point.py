"""Plans from point to point: the limits, the targets, the time they take; what is refused, and how it is told."""

from __future__ import annotations

import math
import random
import sys
from dataclasses import replace
from itertools import pairwise

import pytest

from canopen_master.errors import PackageMissingError, PlanRefusedError
from canopen_master.trajectories.point_to_point import MARGIN, point_to_point
from canopen_proto.drives.trajectory import JointLimits, Path, PathPoint
from tests.master.path_extremes import assert_keeps, extremes

ruckig = pytest.importorskip("ruckig")

LIMITS = JointLimits(lowest=-90.0, highest=90.0, speed=100.0, acceleration=400.0, jerk=4000.0)


def at_rest(*positions: float) -> PathPoint:
    return PathPoint(list(positions), [0.0] * len(positions), [0.0] * len(positions))


def random_limits(rng: random.Random, smallest: float, largest: float) -> JointLimits:
    """A joint with a speed of that size, in powers of ten, and full speed within 10 ms to 3 s."""
    speed = 10.0 ** rng.uniform(smallest, largest)
    acceleration = speed / 10.0 ** rng.uniform(-2, 0.5)
    return JointLimits(speed=speed, acceleration=acceleration, jerk=acceleration / 10.0 ** rng.uniform(-2, 0))


def seven_phases(distance: float, speed: float, acceleration: float, jerk: float) -> float:
    """The least time from rest to rest: the closed form of the profile of seven phases."""
    ramp = acceleration / jerk + speed / acceleration if speed * jerk >= acceleration**2 else 2.0 * math.sqrt(speed / jerk)
    if distance >= speed * ramp:
        return ramp + distance / speed
    if distance >= 2.0 * acceleration**3 / jerk**2:
        return acceleration / jerk + math.sqrt((acceleration / jerk) ** 2 + 4.0 * distance / acceleration)
    return 4.0 * (distance / (2.0 * jerk)) ** (1.0 / 3.0)


def duration_by_ruckig(start: PathPoint, targets: list[float], limits: list[JointLimits], margin: float) -> float:
    """What ruckig itself says of the same task, asked in the user's units."""
    request = ruckig.InputParameter(len(limits))
    request.current_position, request.current_velocity, request.current_acceleration = start
    request.target_position = targets
    request.max_velocity = [each.speed for each in limits]
    request.max_acceleration = [each.acceleration * (1.0 - margin) for each in limits]  # type: ignore[operator]
    request.max_jerk = [each.jerk * (1.0 - margin) for each in limits]  # type: ignore[operator]
    trajectory = ruckig.Trajectory(len(limits))
    ruckig.Ruckig(len(limits)).calculate(request, trajectory)
    duration: float = trajectory.duration
    return duration


def assert_ends(path: Path, targets: list[float], limits: list[JointLimits]) -> None:
    """The end is the target itself, at rest, but for the last digits of floats."""
    end = path.end
    for joint, each in enumerate(limits):
        assert end.positions[joint] == pytest.approx(targets[joint], rel=1e-12, abs=1e-12 * each.speed)  # type: ignore[operator]
        assert end.velocities[joint] == pytest.approx(0.0, abs=1e-9 * each.speed)  # type: ignore[operator]
        assert end.accelerations[joint] == pytest.approx(0.0, abs=1e-9 * each.acceleration)  # type: ignore[operator]


@pytest.mark.parametrize("distance", [0.001, 1.0, 7.9, 30.0, 179.0], ids=lambda each: f"{each:g} degrees")
def test_one_joint_takes_the_least_time_there_is(distance: float) -> None:
    path = point_to_point(at_rest(-90.0), [distance - 90.0], [LIMITS], margin=0.0)
    assert path.duration == pytest.approx(seven_phases(distance, 100.0, 400.0, 4000.0), rel=1e-6)
    assert_ends(path, [distance - 90.0], [LIMITS])
    assert_keeps(path, [LIMITS], 0.0)


@pytest.mark.thorough(4)
@pytest.mark.parametrize("seed", range(40))
def test_any_motion_keeps_its_limits_and_takes_no_longer_than_ruckig_says(seed: int) -> None:
    rng = random.Random(seed)
    is_usual = seed % 4 < 2  # else micrometres to encoder counts, some of which ruckig itself refuses in these units
    limits = [random_limits(rng, *((0, 2.5) if is_usual else (-4, 6))) for _ in range(rng.choice((1, 2, 6, 12)))]
    start = at_rest(*[rng.uniform(-10, 10) * each.speed for each in limits])  # type: ignore[operator]
    if seed % 2:  # from a state of motion within the limits, whose speed also stays within them
        accelerations = [rng.uniform(-0.7, 0.7) * each.acceleration for each in limits]  # type: ignore[operator]
        rises = [a * a / each.jerk for a, each in zip(accelerations, limits, strict=True)]  # type: ignore[operator]
        rooms = [max(0.0, each.speed - rise) for rise, each in zip(rises, limits, strict=True)]  # type: ignore[operator]
        accelerations = [a if room else 0.0 for a, room in zip(accelerations, rooms, strict=True)]
        velocities = [rng.uniform(-room, room) for room in rooms]
        start = PathPoint(start.positions, velocities, accelerations)
    distances = [rng.choice((-1, 0, 1)) * each.speed * 10.0 ** rng.uniform(-4, 1.5) for each in limits]  # type: ignore[operator]
    targets = [position + distance for position, distance in zip(start.positions, distances, strict=True)]

    path = point_to_point(start, targets, limits)

    assert_keeps(path, limits, MARGIN)
    assert_ends(path, targets, limits)
    assert path.start.positions == start.positions
    assert path.start.velocities == pytest.approx(start.velocities)
    assert path.start.accelerations == pytest.approx(start.accelerations)
    if is_usual and (any(distances) or seed % 2):
        assert path.duration == pytest.approx(duration_by_ruckig(start, targets, limits, MARGIN), rel=0.01)


@pytest.mark.parametrize("joints", range(1, 13))
def test_from_rest_to_rest_the_slowest_joint_takes_its_least_time(joints: int) -> None:
    """Theory knows the time of each joint alone; ruckig is not asked."""
    rng = random.Random(joints)
    limits = [random_limits(rng, 0, 2.5) for _ in range(joints)]
    distances = [rng.choice((-1, 1)) * each.speed * 10.0 ** rng.uniform(-2, 1) for each in limits]  # type: ignore[operator]
    path = point_to_point(at_rest(*[0.0] * joints), distances, limits, margin=0.0)
    least = [
        seven_phases(abs(distance), each.speed, each.acceleration, each.jerk)  # type: ignore[arg-type]
        for distance, each in zip(distances, limits, strict=True)
    ]
    assert path.duration == pytest.approx(max(least), rel=1e-6)
    assert_keeps(path, limits, 0.0)


def test_the_samples_of_a_plan_show_the_same_limits() -> None:
    """Differences of positions know nothing of the polynomials."""
    limits = [LIMITS, JointLimits(speed=50.0, acceleration=100.0, jerk=800.0)]
    path = point_to_point(at_rest(-80.0, 0.0), [75.0, 20.0], limits, margin=0.0)
    step = 1e-3
    samples = [path.at(number * step).positions for number in range(int(path.duration / step) + 2)]
    for joint, each in enumerate(limits):
        values = [sample[joint] for sample in samples]
        for limit in (each.speed, each.acceleration, each.jerk):
            assert limit is not None
            values = [(after - before) / step for before, after in pairwise(values)]
            assert max(map(abs, values)) <= limit * (1.0 + 1e-4)
            assert joint or max(map(abs, values)) >= limit * 0.99  # the joint that takes longest goes at its limits


@pytest.mark.parametrize(("velocity", "acceleration"), [(250.0, 0.0), (-180.0, -900.0), (99.0, 1000.0), (0.0, -2000.0)])
def test_a_start_beyond_the_limits_is_brought_back_within_them(velocity: float, acceleration: float) -> None:
    limits = [JointLimits(speed=100.0, acceleration=400.0, jerk=4000.0)] * 2
    path = point_to_point(PathPoint([0.0, 0.0], [velocity, 0.0], [acceleration, 0.0]), [30.0, 10.0], limits)
    assert path.start == ([0.0, 0.0], [velocity, 0.0], [acceleration, 0.0])
    assert_ends(path, [30.0, 10.0], limits)
    seen = extremes(path, 0)
    assert seen.jerk <= 3200.0 * (1.0 + 1e-6)
    peak = abs(velocity + acceleration * abs(acceleration) / 2.0 / 3200.0)
    assert seen.speed <= max(peak, abs(velocity)) * (1.0 + 1e-6)
    assert seen.acceleration <= max(abs(acceleration), 320.0) * (1.0 + 1e-6)
    assert abs(path.at(0.9 * path.duration).velocities[0]) <= 100.0 * (1.0 + 1e-6)


def test_a_new_target_on_the_way_is_reached_without_a_stop() -> None:
    first = point_to_point(at_rest(0.0, 0.0), [80.0, 40.0], [LIMITS, LIMITS])
    present = first.at(0.5 * first.duration)
    path = point_to_point(present, [85.0, 60.0], [LIMITS, LIMITS])
    assert path.start == present
    speeds = [path.at(number * path.duration / 50).velocities[0] for number in range(45)]
    assert min(speeds) > 1.0
    assert_keeps(path, [LIMITS, LIMITS], MARGIN)


def test_all_joints_arrive_together_and_start_together() -> None:
    path = point_to_point(at_rest(0.0, 0.0, 10.0), [80.0, 1.0, 10.0], [LIMITS] * 3)
    before = path.at(path.duration * 0.95)
    assert before.velocities[0] != 0.0
    assert before.velocities[1] != 0.0
    assert extremes(path, 2)[:3] == (10.0, 10.0, 0.0)


def test_joints_that_are_there_already_make_a_path_that_rests() -> None:
    path = point_to_point(at_rest(5.0, 6.0), [5.0, 6.0], [LIMITS] * 2)
    assert 0.0 < path.duration < 0.01
    assert path.end == at_rest(5.0, 6.0)


def test_a_least_duration_and_a_part_of_the_speed() -> None:
    assert point_to_point(at_rest(0.0), [10.0], [LIMITS], minimum_duration=5.0).duration == pytest.approx(5.0)
    assert point_to_point(at_rest(0.0), [0.0], [LIMITS], minimum_duration=5.0).duration == pytest.approx(5.0)
    path = point_to_point(at_rest(0.0), [80.0], [LIMITS], speed_factor=0.1)
    assert extremes(path, 0).speed == pytest.approx(10.0)
    assert path.duration == pytest.approx(seven_phases(80.0, 10.0, 320.0, 3200.0), rel=1e-6)


def test_a_joint_that_would_leave_its_limits_by_waiting_arrives_earlier() -> None:
    """Joint 2 can reach its target directly, but in the time that joint 1 needs only by a detour to 90.02."""
    start = PathPoint([-4.0, -22.0, 75.0, 4.0], [85.0, -36.0, 76.0, 26.0], [-93.0, 86.0, 83.0, 133.0])
    targets = [14.0, -83.0, 87.0, 52.0]
    assert extremes(point_to_point(start, targets, [replace(LIMITS, highest=100.0)] * 4), 2).highest > 90.0
    path = point_to_point(start, targets, [LIMITS] * 4)
    assert_keeps(path, [LIMITS] * 4, MARGIN)
    assert_ends(path, targets, [LIMITS] * 4)


@pytest.mark.parametrize(("target", "limit"), [(90.5, 90.0), (-1000.0, -90.0)])
def test_a_target_beyond_a_limit_is_refused_with_joint_value_and_limit(target: float, limit: float) -> None:
    with pytest.raises(PlanRefusedError, match=f"joint 1 cannot go to {target:g}\n.*{limit:g}") as refused:
        point_to_point(at_rest(0.0, 0.0), [0.0, target], [LIMITS] * 2)
    assert (refused.value.joint, refused.value.value, refused.value.limit) == (1, target, limit)


def test_a_joint_beyond_its_limit_may_stay_or_come_back_but_not_go_further() -> None:
    assert point_to_point(at_rest(95.0), [95.0], [LIMITS]).end.positions == [95.0]
    assert point_to_point(at_rest(95.0), [20.0], [LIMITS]).end.positions == pytest.approx([20.0])
    with pytest.raises(PlanRefusedError, match="joint 0 cannot go to 95.1"):
        point_to_point(at_rest(95.0), [95.1], [LIMITS])


def test_a_start_too_fast_to_stop_before_the_limit_is_refused() -> None:
    with pytest.raises(PlanRefusedError, match="joint 0 moves too fast to stop before its limit") as refused:
        point_to_point(PathPoint([85.0], [100.0], [0.0]), [80.0], [LIMITS])
    assert refused.value.joint == 0
    assert refused.value.limit == 90.0
    assert refused.value.value is not None
    assert refused.value.value > 90.0


@pytest.mark.thorough(4)
@pytest.mark.parametrize("seed", range(40))
def test_no_blend_leaves_the_position_limits_unseen(seed: int) -> None:
    rng = random.Random(seed)
    limits = [LIMITS, LIMITS]
    start = PathPoint(*[[rng.uniform(-most, most) for _ in limits] for most in (80.0, 100.0, 300.0)])
    targets = [rng.uniform(-90.0, 90.0) for _ in limits]
    try:
        path = point_to_point(start, targets, limits)
    except PlanRefusedError as refused:  # only where the stop that is due at once is too long
        assert refused.joint is not None
        position, velocity = start.positions[refused.joint], start.velocities[refused.joint]
        assert abs(position + math.copysign(velocity**2 / 2.0 / 320.0, velocity)) + 20.0 > 90.0
        assert refused.value is not None
        assert abs(refused.value) > 90.0
    else:
        for joint in range(2):
            seen = extremes(path, joint)
            assert seen.lowest >= -90.0 - 1e-6
            assert seen.highest <= 90.0 + 1e-6


@pytest.mark.parametrize(
    ("start", "targets", "options", "text"),
    [
        (at_rest(0.0, 0.0), [1.0], {}, "one target for each joint\n.*1 for 2 joints"),
        (at_rest(0.0, 0.0), None, {}, "one target for each joint\n.*None is no list of numbers"),
        (at_rest(0.0, 0.0), [1.0, "2"], {}, "one target for each joint\n.*'2' is no number"),
        (at_rest(0.0), [1.0, 2.0], {}, "one position at the start for each joint"),
        (PathPoint([0.0, 0.0], [0.0], [0.0, 0.0]), [1.0, 2.0], {}, "one velocity at the start for each joint"),
        (at_rest(0.0, 0.0), [1.0, math.nan], {}, "the target of joint 1 is no finite number"),
        (at_rest(0.0, math.inf), [1.0, 1.0], {}, "the position at the start of joint 1 is no finite number"),
        (PathPoint([0.0] * 2, [0.0] * 2, [math.nan, 0.0]), [1.0, 1.0], {}, "acceleration at the start of joint 0"),
        (at_rest(0.0, 0.0), [1.0, 1.0], {"margin": 1.0}, "margin must be from 0 to below 1"),
        (at_rest(0.0, 0.0), [1.0, 1.0], {"speed_factor": 0.0}, "speed_factor must be above 0 and at most 1"),
        (at_rest(0.0, 0.0), [1.0, 1.0], {"speed_factor": math.nan}, "speed_factor must be above 0 and at most 1"),
        (at_rest(0.0, 0.0), [1.0, 1.0], {"minimum_duration": -1.0}, "minimum_duration must be 0 s or more"),
        (at_rest(0.0, 0.0), [1.0, 1.0], {"minimum_duration": math.inf}, "minimum_duration must be 0 s or more"),
    ],
)  # fmt: skip
def test_what_makes_no_task_is_refused(start: PathPoint, targets: list[float], options: dict[str, float], text: str) -> None:
    with pytest.raises(PlanRefusedError, match=text):
        point_to_point(start, targets, [LIMITS] * 2, **options)


@pytest.mark.parametrize(
    ("limits", "text"),
    [
        (JointLimits(acceleration=1.0, jerk=1.0), "no limit of its speed"),
        (JointLimits(speed=1.0, acceleration=math.inf, jerk=1.0), "no limit of its acceleration"),
        (JointLimits(speed=1.0, acceleration=1.0), "no limit of its jerk"),
    ],
)
def test_a_plan_needs_all_three_limits(limits: JointLimits, text: str) -> None:
    with pytest.raises(PlanRefusedError, match=f"joint 1 has {text}") as refused:
        point_to_point(at_rest(0.0, 0.0), [1.0, 1.0], [LIMITS, limits])
    assert refused.value.joint == 1


def test_what_ruckig_cannot_do_is_told_with_joint_and_cause() -> None:
    odd = JointLimits(speed=1.0, acceleration=1000.0, jerk=0.01)
    with pytest.raises(PlanRefusedError, match="(?s)ruckig found no path.*joint 1.*cause:.*try:") as refused:
        point_to_point(PathPoint([0.0, 0.0], [0.0, 5.0], [0.0, 2500.0]), [1.0, 1e-3], [LIMITS, odd])
    assert refused.value.joint == 1


def test_a_path_of_hours_is_refused_if_several_joints_have_to_wait_for_each_other() -> None:
    with pytest.raises(PlanRefusedError, match="(?s)longer than.*speed"):
        point_to_point(at_rest(0.0, 0.0), [8000.0, 1.0], [JointLimits(speed=1.0, acceleration=1.0, jerk=1.0)] * 2)


def test_without_ruckig_the_error_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ruckig", None)
    with pytest.raises(PackageMissingError, match="planning a motion needs the package ruckig") as missing:
        point_to_point(at_rest(0.0), [1.0], [LIMITS])
    assert missing.value.tries == ("pip install 'canopen-proto[motion]'",)
