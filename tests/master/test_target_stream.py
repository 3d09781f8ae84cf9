"""Streams of targets and velocities: the limits in every cycle whatever comes, the dead man's switch, the end at rest."""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Sequence
from itertools import pairwise

import pytest

from canopen_master.errors import PackageMissingError, PlanRefusedError
from canopen_master.trajectories.point_to_point import point_to_point
from canopen_master.trajectories.target_stream import TargetStream
from canopen_proto.drives.trajectory import JointLimits, PathPoint

pytest.importorskip("ruckig")

CYCLE = 0.004
SPEED, ACCELERATION, JERK = 100.0, 400.0, 4000.0
LIMITS = JointLimits(-90.0, 90.0, SPEED, ACCELERATION, JERK)
EXACT = 1.0 + 1e-9


def at_rest(*positions: float) -> PathPoint:
    return PathPoint(list(positions), [0.0] * len(positions), [0.0] * len(positions))


def one_joint(position: float = 0.0, velocity: float = 0.0, renew_cycles: int | None = None) -> TargetStream:
    return TargetStream(PathPoint([position], [velocity], [0.0]), [LIMITS], CYCLE, renew_cycles=renew_cycles)


def run(stream: TargetStream, steps: int) -> list[PathPoint]:
    """Let cycles pass; check that each continues the one before within the limits of a joint of this file."""
    points = [stream.point, *(stream.step() for _ in range(steps))]
    for before, after in pairwise(points):
        assert_one_cycle(before, after, [LIMITS] * len(after.positions), CYCLE)
    return points


def run_to_rest(stream: TargetStream) -> list[PathPoint]:
    points = run(stream, 1)
    while not stream.is_at_rest:
        points += run(stream, 1)[1:]
        assert len(points) < 5000
    return points


def assert_one_cycle(before: PathPoint, after: PathPoint, limits: Sequence[JointLimits], cycle: float) -> None:
    """No limit is exceeded, and position, speed and acceleration belong together: no value jumps."""
    for joint, each in enumerate(limits):
        assert each.speed is not None
        assert each.acceleration is not None
        assert each.jerk is not None
        (p0, v0, a0), (p1, v1, a1) = ([values[joint] for values in point] for point in (before, after))
        assert abs(v1) <= each.speed * EXACT
        assert abs(a1) <= each.acceleration * EXACT
        assert abs(a1 - a0) <= each.jerk * cycle * EXACT
        assert abs(v1 - v0 - cycle * (a0 + a1) / 2.0) <= each.jerk * cycle**2 / 4.0 * EXACT
        rounding = 1e-14 * max(abs(p0), abs(p1))
        assert abs(p1 - p0 - cycle * (v0 + v1) / 2.0) <= each.jerk * cycle**3 / 12.0 * 1.00001 + rounding
        assert each.lowest is None or p1 >= each.lowest - 1e-8 * each.speed
        assert each.highest is None or p1 <= each.highest + 1e-8 * each.speed


@pytest.mark.thorough(3)
@pytest.mark.parametrize("seed", range(16))
def test_whatever_comes_no_joint_exceeds_a_limit_in_any_cycle(seed: int) -> None:
    rng = random.Random(seed)
    cycle = rng.choice((0.001, 0.004, 0.01))
    limits = []
    for _ in range(rng.choice((1, 2, 5))):
        speed = 10.0 ** rng.uniform(-4, 6)
        acceleration = speed / 10.0 ** rng.uniform(-1.5, 0.3)
        reach = speed * 10.0 ** rng.uniform(-1.5, 1)
        limits.append(JointLimits(-reach, reach, speed, acceleration, acceleration / 10.0 ** rng.uniform(-1.5, 0)))
    ends = [each.highest or 0.0 for each in limits]
    speeds = [each.speed or 0.0 for each in limits]
    stream = TargetStream(at_rest(*[rng.uniform(-end, end) for end in ends]), limits, cycle)
    before = stream.point
    for number in range(700):
        chance = 0.3 if 300 <= number < 400 else 0.02  # a time of many targets, between times of few
        if rng.random() < chance:
            if rng.random() < 0.5:
                stream.aim_at([rng.uniform(-1.5, 1.5) * end for end in ends])
            else:
                stream.move_at([rng.choice((-2.0, -1.0, -0.3, 0.0, 0.01, 0.3, 1.0)) * speed for speed in speeds])
        after = stream.step()
        assert_one_cycle(before, after, limits, cycle)
        before = after
    stream.stop()
    for _ in range(int(4.0 / cycle)):
        if stream.is_at_rest:
            break
        before, after = after, stream.step()
        assert_one_cycle(before, after, limits, cycle)
    assert stream.is_at_rest
    assert stream.step() == stream.point
    assert stream.failure is None


def test_a_target_is_reached_in_the_least_time_and_the_joint_rests_there() -> None:
    stream = TargetStream(at_rest(0.0, 10.0), [LIMITS] * 2, CYCLE)
    stream.aim_at([60.0, 10.5])
    points = run_to_rest(stream)
    least = point_to_point(at_rest(0.0), [60.0], [LIMITS], margin=0.0).duration
    assert (len(points) - 2) * CYCLE <= least <= (len(points) - 1) * CYCLE
    assert stream.point.positions == pytest.approx([60.0, 10.5], abs=1e-9)
    assert stream.step().positions == pytest.approx([60.0, 10.5], abs=1e-9)
    assert not stream.is_stopping


def test_a_new_target_on_the_way_is_taken_without_a_stop() -> None:
    stream = one_joint()
    stream.aim_at([30.0])
    assert run(stream, 80)[-1].velocities[0] > 50.0
    stream.aim_at([80.0])
    points = run_to_rest(stream)
    assert min(point.velocities[0] for point in points[:100]) > 50.0
    assert stream.point.positions == pytest.approx([80.0], abs=1e-9)


def test_a_velocity_is_kept_until_another_one_comes() -> None:
    stream = one_joint(-80.0)
    stream.move_at([40.0])
    assert run(stream, 200)[-1].velocities == pytest.approx([40.0])
    stream.move_at([-25.0])
    assert run(stream, 100)[-1].velocities == pytest.approx([-25.0])
    stream.move_at([0.0])
    run_to_rest(stream)
    assert not stream.is_stopping


def test_a_jog_that_slows_down_neither_turns_back_nor_undershoots() -> None:
    stream = one_joint(-80.0)
    stream.move_at([100.0])
    run(stream, 200)
    stream.move_at([2.0])
    velocities = [point.velocities[0] for point in run(stream, 200)]
    assert min(velocities) >= 2.0 / EXACT
    assert velocities[-1] == pytest.approx(2.0)


@pytest.mark.parametrize("velocity", [1.0, 30.0, 100.0, -100.0])
def test_a_jog_into_a_position_limit_brakes_in_time_and_rests_there(velocity: float) -> None:
    end = math.copysign(90.0, velocity)
    stream = one_joint(end - math.copysign(5.0, velocity))
    stream.move_at([velocity])
    points = run(stream, int(6.0 / abs(velocity) / CYCLE) + 300)
    assert points[-1].positions == pytest.approx([end], abs=1e-9)
    assert stream.is_at_rest
    jerks = [(after.accelerations[0] - before.accelerations[0]) / CYCLE for before, after in pairwise(points)]
    changes = sum(abs(after - before) > JERK / 10.0 for before, after in pairwise(jerks))
    assert changes <= 14  # the seven phases, each of which may begin within a cycle: no chatter
    stream.move_at([-velocity])
    assert abs(run(stream, 60)[-1].positions[0]) < 90.0 - min(0.1, abs(velocity) / 100)


def test_targets_and_velocities_beyond_the_limits_count_as_the_limits() -> None:
    stream = one_joint(80.0)
    stream.aim_at([1000.0])
    run_to_rest(stream)
    assert stream.point.positions == pytest.approx([90.0], abs=1e-9)
    stream.move_at([-1000.0])
    assert run(stream, 150)[-1].velocities == pytest.approx([-100.0])


def test_stop_brakes_at_once_and_ends_the_stream() -> None:
    stream = one_joint()
    stream.move_at([100.0])
    begin = run(stream, 150)[-1]
    assert begin.velocities == pytest.approx([100.0])
    stream.stop()
    points = run_to_rest(stream)
    least = SPEED / 2.0 * (SPEED / ACCELERATION + ACCELERATION / JERK)
    assert stream.point.positions[0] - begin.positions[0] == pytest.approx(least, rel=1e-6)
    assert (len(points) - 2) * CYCLE <= SPEED / ACCELERATION + ACCELERATION / JERK
    assert stream.is_stopping
    for command in (stream.aim_at, stream.move_at):
        with pytest.raises(PlanRefusedError, match="the stream has ended"):
            command([1.0])
    stream.renew()
    assert stream.step() == stream.point == points[-1]


def test_a_stream_without_a_goal_brakes_what_moves() -> None:
    stream = one_joint(velocity=50.0)
    run_to_rest(stream)
    assert stream.point.positions[0] == pytest.approx(25.0 * (50.0 / 400.0 + 0.1), rel=1e-6)
    assert one_joint(12.0).step() == at_rest(12.0)


def test_the_dead_mans_switch_counts_cycles() -> None:
    stream = one_joint(-80.0, renew_cycles=25)
    stream.move_at([50.0])
    for _ in range(10):
        run(stream, 20)
        stream.renew()
    assert run(stream, 25)[-1].velocities == pytest.approx([50.0])
    assert not stream.is_stopping
    assert run(stream, 1)[-1].velocities[0] < 50.0  # the 26th
    assert stream.is_stopping
    run_to_rest(stream)
    with pytest.raises(PlanRefusedError, match="not renewed in time"):
        stream.move_at([50.0])


def test_a_short_gap_counts_for_the_dead_mans_switch_and_takes_no_speed() -> None:
    stream = one_joint(-80.0, renew_cycles=25)
    stream.move_at([5.0])
    for _ in range(20):
        stream.step()
    before = stream.point
    stream.after_gap(2, from_rest=False)
    assert stream.point == before
    stream.after_gap(4, from_rest=False)
    stream.step()
    assert stream.is_stopping


def test_a_new_goal_renews_too() -> None:
    stream = one_joint(-80.0, renew_cycles=5)
    for number in range(20):
        stream.move_at([10.0 + number])
        run(stream, 5)
    assert not stream.is_stopping
    run(stream, 1)
    assert stream.is_stopping


def test_a_start_too_fast_to_stop_in_time_goes_no_further_than_it_must() -> None:
    stream = TargetStream(PathPoint([85.0], [100.0], [0.0]), [LIMITS], CYCLE)
    stream.move_at([100.0])
    points = [stream.step() for _ in range(400)]
    braking = 50.0 * (SPEED / ACCELERATION + ACCELERATION / JERK)
    assert points[-1].positions == pytest.approx([85.0 + braking], abs=1e-6)
    assert stream.is_at_rest
    assert points[-1] == points[-50]


def test_a_joint_that_starts_beyond_a_limit_may_stay_or_come_back() -> None:
    stream = one_joint(95.0)
    stream.aim_at([95.0])
    assert stream.step() == at_rest(95.0)
    stream.move_at([10.0])
    assert [stream.step() for _ in range(50)][-1].positions == pytest.approx([95.0], abs=1e-9)
    stream.move_at([-50.0])
    assert [stream.step() for _ in range(200)][-1].positions[0] < 80.0


def test_a_start_beyond_speed_and_acceleration_is_brought_back() -> None:
    stream = TargetStream(PathPoint([0.0], [150.0], [600.0]), [JointLimits(None, None, SPEED, ACCELERATION, JERK)], CYCLE)
    stream.move_at([100.0])
    points = [stream.step() for _ in range(300)]
    assert points[-1].velocities == pytest.approx([100.0])
    accelerations = [600.0, *[point.accelerations[0] for point in points]]
    assert max(abs(b - a) for a, b in pairwise(accelerations)) <= JERK * CYCLE * EXACT


@pytest.mark.parametrize("values", [[1.0], [1.0, 2.0, 3.0], [math.nan, 1.0], [1.0, -math.inf]])
def test_a_goal_of_no_use_is_refused_and_the_one_before_stays(values: list[float]) -> None:
    stream = TargetStream(at_rest(0.0, 0.0), [LIMITS] * 2, CYCLE)
    stream.aim_at([5.0, 6.0])
    for command in (stream.aim_at, stream.move_at):
        with pytest.raises(PlanRefusedError, match="one (target|velocity) for each joint|is no finite number"):
            command(values)
    run_to_rest(stream)
    assert stream.point.positions == pytest.approx([5.0, 6.0], abs=1e-9)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"cycle_time": 0.0}, "cycle_time must be above 0 s"),
        ({"cycle_time": math.nan}, "cycle_time must be above 0 s"),
        ({"renew_cycles": 0}, "renew_cycles must be 1 or more"),
        ({"speed_factor": 1.1}, "speed_factor must be above 0 and at most 1"),
        ({"limits": [JointLimits(speed=1.0, acceleration=1.0)]}, "joint 0 has no limit of its jerk"),
        ({"start": at_rest(0.0, 0.0)}, "one position at the start for each joint"),
    ],
)
def test_a_stream_that_cannot_be_is_refused(arguments: dict[str, object], text: str) -> None:
    usual: dict[str, object] = {"start": at_rest(0.0), "limits": [LIMITS], "cycle_time": CYCLE}
    with pytest.raises(PlanRefusedError, match=text):
        TargetStream(**{**usual, **arguments})  # type: ignore[arg-type]


def test_if_ruckig_fails_the_stream_stops_and_says_why() -> None:
    stream = one_joint(-80.0)
    stream.move_at([80.0])
    before = run(stream, 100)[-1]
    generator = stream._generator

    class FailsOnce:
        failed = False

        def update(self, *arguments: object) -> object:
            if not self.failed:
                self.failed = True
                raise ValueError("[ruckig] error in step 1, dof: 0 input: ...")
            return generator.update(*arguments)

    stream._generator = FailsOnce()
    after = stream.step()
    assert_one_cycle(before, after, [LIMITS], CYCLE)
    run_to_rest(stream)
    assert stream.failure is not None
    assert stream.failure.joint == 0
    with pytest.raises(PlanRefusedError, match="the stream has ended") as refused:
        stream.move_at([1.0])
    assert refused.value.__cause__ is stream.failure


def test_without_ruckig_the_error_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ruckig", None)
    with pytest.raises(PackageMissingError, match="a stream of targets needs the package ruckig"):
        one_joint()
