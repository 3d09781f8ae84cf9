"""What moves a chain: plans, blends, the override, jogging, targets, several chains as one; and what is refused."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_master import (
    ChainError,
    ChainHaltedError,
    ChainState,
    MotionReplacedError,
    PathRefusedError,
    PlanRefusedError,
    Progress,
    through_points,
    together,
)
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.trajectory import Path, PathError, Segment, from_function
from canopen_proto.machine import LocalProtocolError
from tests.examples import examples
from tests.loops import jump, loop
from tests.master.direct_world import patient
from tests.master.path_world import AXIS, CYCLE, DRIVE, Record, arms, swing
from tests.master.test_path_motion import ON_PATH, WITHIN, distance_from, moved
from tests.master.world import virtual_time


def assert_within_limits(record: Record) -> None:
    assert record.largest(1) <= 1.0 + 1e-3
    assert record.largest(2) <= 4.0 * WITHIN + 0.05
    assert record.largest(3) <= 40.0 * WITHIN + 4.0


targets = st.lists(st.floats(-3, 3), min_size=2, max_size=2)


@examples(6, least=3)
@given(st.lists(st.tuples(targets, st.floats(0.05, 2.5), st.floats(0.1, 1.0)), min_size=1, max_size=4))
def test_moves_and_blends_keep_every_limit_and_arrive(moves: list[tuple[list[float], float, float]]) -> None:
    @virtual_time
    async def run() -> None:
        async with arms(2) as (_, [arm], record):
            await arm.move([0.0, 0.0])  # a move that comes while the first one only begins to follow is refused
            async with loop.open_nursery() as nursery:

                async def move(to: list[float], speed: float, is_last: bool) -> None:
                    try:
                        await arm.move(to, speed=speed)
                    except MotionReplacedError:
                        assert not is_last

                for number, (to, seconds, speed) in enumerate(moves, start=1):
                    nursery.start_soon(move, to, speed, number == len(moves))
                    await loop.sleep(seconds)
            assert record.rows[-1] == pytest.approx(moves[-1][0], abs=3e-6)
            assert_within_limits(record)

    run()


@examples(6, least=3)
@given(st.lists(st.tuples(st.sampled_from([0.0, 0.1, 0.5, 0.9, 1.0]), st.floats(0.01, 0.6)), min_size=1, max_size=6))
def test_the_override_changes_the_rate_on_the_path_and_within_the_limits(changes: list[tuple[float, float]]) -> None:
    @virtual_time
    async def run() -> None:
        async with arms(2) as (_, [arm], record):
            path = swing(0.5, -0.25, duration=1.0)
            async with loop.open_nursery() as nursery:
                nursery.start_soon(arm.follow, path)
                for override, seconds in changes:
                    arm.override = override
                    await loop.sleep(seconds)
                arm.override = 1.0
            assert record.rows[-1] == pytest.approx([0.5, -0.25], abs=3e-6)
            assert max(distance_from(path, row) for row in record.rows) < ON_PATH
            assert_within_limits(record)

    run()


@virtual_time
async def test_a_pause_stands_on_the_path_until_it_goes_on() -> None:
    async with arms(2) as (_, [arm], record):
        path = swing(0.5, -0.25, duration=2.0)
        async with loop.open_nursery() as nursery:
            nursery.start_soon(arm.follow, path)
            await moved(arm, 0.8)
            arm.pause()
            await loop.sleep(2)
            paused = list(record.rows[-1])
            assert record.rows[-50] == pytest.approx(paused, abs=1e-9)
            assert 0.2 < paused[0] < 0.45
            assert arm.state is ChainState.FOLLOWING
            arm.resume()
        assert record.rows[-1] == pytest.approx([0.5, -0.25], abs=3e-6)
        assert_within_limits(record)


@virtual_time
async def test_progress_tells_each_cycle_of_the_motion() -> None:
    async with arms(2) as (_, [arm], _):
        seen: list[Progress] = []
        async with loop.open_nursery() as nursery:

            async def watch() -> None:
                seen.extend([progress async for progress in arm.progress()])

            nursery.start_soon(watch)
            await loop.sleep(0.1)
            await arm.follow(swing(0.5, -0.25, duration=1.0))
        assert [each.time for each in seen] == pytest.approx([CYCLE * number for number in range(1, len(seen) + 1)])
        assert seen[-1].set_points == pytest.approx([0.5, -0.25], abs=3e-6)
        assert seen[-1].positions == pytest.approx([0.5, -0.25], abs=1e-4)
        assert all(0 <= each.override <= 1 for each in seen)
        assert max(abs(error) for each in seen for error in each.following_errors) < 1e-3


@virtual_time
async def test_a_jog_moves_as_long_as_it_is_renewed_and_brakes_when_its_block_ends() -> None:
    async with arms(2) as (_, [arm], record):
        async with arm.jog() as jog:
            for _ in range(20):
                jog.velocity([0.4, -5.0])
                await loop.sleep(0.05)
            assert record.derivatives(1)[-1] == pytest.approx([0.4, -1.0], abs=1e-3)
        await loop.sleep(2 * CYCLE)
        at_end = record.rows[-1]
        await loop.sleep(0.3)
        assert record.rows[-1] == pytest.approx(at_end, abs=1e-6)
        assert arm.state is ChainState.FOLLOWING
        assert_within_limits(record)


@virtual_time
async def test_a_jog_whose_caller_hangs_brakes_by_its_dead_man() -> None:
    async with arms(2) as (_, [arm], record):
        async with arm.jog(renew_within=0.1) as jog:
            jog.velocity([0.4, 0.0])
            await loop.sleep(3)
            begun = record.times[next(number for number, row in enumerate(record.derivatives(1)) if row[0] > 1e-6)]
            stood = record.times[max(number for number, row in enumerate(record.derivatives(1)) if row[0] > 1e-6)]
            assert stood - begun < 0.6
            with pytest.raises(PlanRefusedError, match="was not renewed in time"):
                jog.velocity([0.4, 0.0])
        assert_within_limits(record)


@pytest.mark.parametrize("way", ["cancelled", "failed"])
@virtual_time
async def test_a_jog_whose_caller_is_gone_brakes(way: str) -> None:
    async with arms(2) as (_, [arm], record):
        with loop.move_on_after(1), pytest.raises(KeyError) if way == "failed" else loop.cancel_scope():
            async with arm.jog(renew_within=100) as jog:
                jog.velocity([0.4, -0.2])
                await loop.sleep(0.5)
                if way == "failed":
                    raise KeyError("a bug of the user's")
                await loop.sleep_forever()
        await loop.sleep(2 * CYCLE)
        assert record.derivatives(1)[-1] == pytest.approx([0, 0], abs=1e-3)
        assert_within_limits(record)


@virtual_time
async def test_targets_may_come_at_any_time() -> None:
    async with arms(2) as (_, [arm], record):
        async with arm.stream() as stream:
            for number in range(60):
                stream.aim_at([0.5 * math.sin(0.1 * number), 0.01 * number])
                await loop.sleep(0.03)
            await loop.sleep(2)
        assert record.rows[-1] == pytest.approx([0.5 * math.sin(5.9), 0.59], abs=3e-6)
        assert_within_limits(record)


@virtual_time
async def test_a_jog_takes_over_from_a_move_and_a_move_from_a_jog() -> None:
    async with arms(2) as (_, [arm], record), loop.open_nursery() as nursery:

        async def move() -> None:
            with pytest.raises(MotionReplacedError):
                await arm.move([3, 3])

        nursery.start_soon(move)
        await moved(arm, 1.0)
        async with arm.jog() as jog:
            jog.velocity([-0.5, 0.5])
            await loop.sleep(0.15)
            await arm.move([1.0, 2.0])
        assert record.rows[-1] == pytest.approx([1.0, 2.0], abs=3e-6)
        assert_within_limits(record)


@virtual_time
async def test_several_chains_move_as_one_and_stop_as_one() -> None:
    async with arms(2, 1) as (_, [arm, leg], record):
        both = together(arm, leg)
        await both.move([0.3, -0.2, 0.1])
        assert record.rows[-1] == pytest.approx([0.3, -0.2, 0.1], abs=3e-6)
        first, last = record.rows[0], record.rows[-1]
        for row in record.rows:  # a plan that is synchronised in time moves them at once, not in proportion
            assert all(min(a, b) - 1e-6 <= x <= max(a, b) + 1e-6 for a, x, b in zip(first, row, last, strict=True))
        async with loop.open_nursery() as nursery:

            async def move() -> None:
                with pytest.raises(ChainError, match="by halt()"):
                    await both.move([0.0, 0.0, 0.0])

            nursery.start_soon(move)
            await moved(leg, 0.4)
            with pytest.raises(ChainError, match="along a path"):
                leg.hold()
            await leg.halt()  # of one of them
        assert arm.state is leg.state is ChainState.HALTED
        assert_within_limits(record)
        with pytest.raises(LocalProtocolError, match="a joint that is in two of them"):
            together(arm, arm)


def line(to: float, duration: float) -> Path:
    return Path([[Segment(duration, (0.0, to / duration))], [Segment(duration, (0.0,))]])


def parabola(acceleration: float) -> Path:
    half = Segment(0.2, (0.0, 0.0, acceleration / 2)), Segment(0.2, (0.02 * acceleration, 0.2 * acceleration, -acceleration / 2))
    return Path([half, [Segment(0.4, (0.0,))]])


REFUSED = {
    "begins elsewhere": (Path([[Segment(1.0, (0.2,))], [Segment(1.0, (0.0,))]]), "does not begin where j01 stands", "0.2"),
    "too fast": (line(3.0, 2.0), "j01 beyond its limit of speed at 0 s", r"speed 1.5 per second, its limit is 1 per second"),
    "too many joints": (swing(0.1, 0.1, 0.1), "the path has 3 joints, not 2", "j01, j02"),
    "beyond": (
        swing(2.5, 0.0, duration=20.0),
        "j01 beyond its limit of position",
        r"its limit is 2: the settings(.|\n)*try: .* `path_limits` (.|\n)*or: .* AxisSettings\(max_position=...\) in `axes`",
    ),
    "no room to stop": (parabola(4.0), "cannot be followed", "leaves nothing free .* j01 needs the acceleration 4"),
}


@pytest.mark.thorough(2)
@pytest.mark.parametrize("case", REFUSED)
@virtual_time
async def test_a_path_is_refused_before_anything_moves(case: str) -> None:
    path, failed, seen = REFUSED[case]
    async with arms(2, axis=replace(AXIS, max_position=2.0, max_jerk=math.inf)) as (_, [arm], record):
        with pytest.raises(PathRefusedError, match=failed) as caught:
            await arm.follow(path)
        assert re.search(seen, str(caught.value)), caught.value
        await loop.sleep(0.3)
        assert record.largest(1) == 0
        assert arm.state is ChainState.FOLLOWING


FARTHEST = 2147.4
"""Nearly the end of INTEGER32, in the unit of these arms: no limit keeps a joint from going there."""


def out_and_back(top: float) -> Path:
    """A path from 0 by `top` to 0, well within all speeds: its ends do not show how far it goes."""
    t = abs(top) * 4.0
    return Path([[Segment(t, (0.0, 0.0, 16 * top / t**2, -32 * top / t**3, 16 * top / t**4))], [Segment(t, (0.0,))]])


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("mode", [Mode.INTERPOLATED_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION])
@virtual_time
async def test_however_a_motion_is_begun_a_position_that_the_drive_can_never_be_given_moves_nothing(
    direction: int, mode: Mode
) -> None:
    axis, far = replace(AXIS, direction=direction), FARTHEST + 1.0
    async with arms(2, 2, axis=axis, mode=mode) as (_, [arm, other], record):
        both = together(arm, other)
        for target in (far, -far):
            for moving, targets in ((arm, [target, 0.0]), (both, [0.0, 0.0, 0.0, target])):
                with pytest.raises(PlanRefusedError, match=f"j[01]. cannot go to {target:g}"):
                    await moving.move(targets)
            for path in (out_and_back(target), lambda start, top=target: out_and_back(top)):
                with pytest.raises(PathRefusedError, match="j01 beyond its limit of position at") as caught:
                    await arm.follow(path)
                assert re.search("what 0x(60C1:01|607A) of the drive can hold", str(caught.value)), caught.value
                assert "takes longer" not in str(caught.value)
                assert "wider limit" not in str(caught.value)
            with pytest.raises(PlanRefusedError, match="would leave its limits"):
                await arm.follow(through_points([[0.0, 0.0], [target, 1.0], [0.0, 0.0]], arm.path_limits))
        await loop.sleep(0.3)
        assert record.largest(1) == 0
        assert arm.state is other.state is ChainState.FOLLOWING


@pytest.mark.parametrize("direction", [1, -1])
@virtual_time
async def test_whatever_a_stream_is_told_no_joint_leaves_what_its_set_point_can_hold(direction: int) -> None:
    axis = replace(AXIS, direction=direction)
    async with arms(1, axis=axis, drive=replace(DRIVE, position=2_147_000_000)) as (_, [arm], _):
        await arm.follow()
        for block, give in ((arm.stream, "aim_at"), (arm.jog, "velocity")):
            async with block() as motion:
                for _ in range(20):
                    getattr(motion, give)([direction * 1e5])
                    await loop.sleep(0.1)
            assert arm.desired_positions == pytest.approx([direction * 2147.4836], abs=1e-4)
            await arm.move([direction * 2147.1])
        assert arm.state is ChainState.FOLLOWING


@virtual_time
async def test_whatever_limits_are_lifted_no_joint_jumps_to_the_start_of_a_path() -> None:
    path, failed, _ = REFUSED["begins elsewhere"]
    async with arms(2, axis=replace(AXIS, max_speed=math.inf, max_acceleration=math.inf)) as (_, [arm], record):
        for given in (path, lambda start: path):
            with pytest.raises(PathRefusedError, match=failed):
                await arm.follow(given)
        assert record.largest(1) == 0


@pytest.mark.parametrize("ahead", [0.0, 0.04, 0.08, math.inf])
@virtual_time
async def test_whatever_ends_meanwhile_a_path_from_rest_without_room_to_stop_is_refused_at_once(ahead: float) -> None:
    """The joints stand in another motion, which ends while the path is looked at, or is paused and never ends."""
    async with arms(2, axis=replace(AXIS, max_position=2.0, max_jerk=math.inf)) as (_, [arm], record):
        await arm.follow()
        arm.override = 0.0 if ahead == math.inf else 1.0
        async with loop.open_nursery() as nursery:
            nursery.start_soon(arm.follow, Path([[Segment(0.05, (0.0,))], [Segment(0.05, (0.0,))]]))
            await loop.sleep(min(ahead, 1.0))
            with loop.move_on_after(5) as limit, pytest.raises(PathRefusedError, match="cannot be followed"):
                await arm.follow(lambda start: parabola(4.0))
            assert not limit.cancelled_caught
            nursery.cancel_scope.cancel()
        assert record.largest(1) == 0


@virtual_time
async def test_what_else_is_refused() -> None:
    async with arms(2) as (_, [arm], record):
        with pytest.raises(PathError, match="from 0"):
            arm.override = 1.5
        with pytest.raises(PlanRefusedError):
            await arm.move([1.0])
        for speed in (0, -0.5, 1.1, math.nan):
            with pytest.raises(PlanRefusedError, match="speed must be above 0 and at most 1") as refused:
                await arm.move([0.1, 0.1], speed=speed)
            assert "speed_factor" not in str(refused.value)
            for block in (arm.jog, arm.stream):
                with pytest.raises(PlanRefusedError, match=": speed must be above 0 and at most 1"):
                    async with block(speed=speed):
                        pass
        for speed in ("x", None, [1.0], True):
            with pytest.raises(PlanRefusedError, match="speed must be a number above 0 and at most 1") as refused:
                await arm.move([0.1, 0.1], speed=speed)
            assert refused.value.seen == repr(speed)
            with pytest.raises(PlanRefusedError, match="speed must be a number above 0 and at most 1"):
                await arm.jog(speed=speed).__aenter__()
        for targets in ({1: 0.1, 2: 0.2}, {0.1, 0.2}):
            with pytest.raises(PlanRefusedError, match="is no list of numbers"):
                await arm.move(targets)
        with pytest.raises(PlanRefusedError, match="beyond all positions"):
            await arm.move([0.0, 10**400])
        async with arm.stream() as targets:
            with pytest.raises(PlanRefusedError, match="beyond all positions"):
                targets.aim_at([0.0, 10**400])
        async with loop.open_nursery() as nursery:
            nursery.start_soon(arm.follow, swing(0.5, -0.25))
            await moved(arm, 0.5)
            with pytest.raises(ChainError, match="it moves along a path"):
                await arm.follow(swing(0.1, 0.1))
            with pytest.raises(ChainError, match="it moves along a path"):
                arm.set_positions([0, 0])
        assert record.rows[-1] == pytest.approx([0.5, -0.25], abs=3e-6)


@pytest.mark.parametrize("blocked", [0.1, 1.0])
@virtual_time
async def test_a_jog_whose_whole_process_hangs_does_not_begin_again_by_itself(blocked: float) -> None:
    """Periods without a SYNC count for the dead man; and drives that stood are not told to move on at full speed."""
    async with arms(1, makers=patient) as (_, [arm], record):
        async with arm.jog(renew_within=0.3) as jog:
            jog.velocity([0.5])
            await loop.sleep(0.25)
            jump(blocked)
            await loop.sleep(3 * CYCLE)
            stood = len(record.rows)
            await loop.sleep(0.5)
            with pytest.raises(PlanRefusedError, match="was not renewed in time"):
                jog.velocity([0.5])
        assert record.rows[-1] == pytest.approx(record.rows[stood - 1], abs=3e-6)


@virtual_time
async def test_a_jog_whose_chain_is_being_halted_says_so() -> None:
    async with arms(1) as (_, [arm], _), loop.open_nursery() as nursery:
        with pytest.raises(ChainHaltedError, match="by halt"):
            async with arm.jog() as jog:
                jog.velocity([0.5])
                await loop.sleep(0.15)
                nursery.start_soon(arm.halt)
                await loop.sleep(2 * CYCLE)
                assert arm.motion is not None  # it brakes
                jog.velocity([0.5])


def long_path() -> Path:
    """A path of 2000 points from rest to rest."""
    duration = CYCLE * 2000
    return from_function(lambda time: [0.15 - 0.15 * math.cos(math.tau * time / duration)] * 2, duration, CYCLE)


@virtual_time
async def test_sync_goes_on_while_a_long_path_is_checked() -> None:
    async with arms(2) as (_, [arm], _), loop.open_nursery() as nursery:
        await arm.follow()
        path = long_path()

        async def take_time() -> None:
            while arm.motion is None:
                jump(0.0005)  # a step of the check takes that
                await loop.checkpoint()

        begin, syncs = loop.current_time(), arm.sync_cycles
        nursery.start_soon(take_time)
        nursery.start_soon(arm.follow, path)
        await moved(arm, CYCLE)
        assert loop.current_time() - begin > 0.1  # it has so many steps
        assert (loop.current_time() - begin) / CYCLE == pytest.approx(arm.sync_cycles - syncs, abs=2)
        assert arm.skipped_cycles == 0
        nursery.cancel_scope.cancel()


@pytest.mark.parametrize("end", ["moves", "halts"])
@virtual_time
async def test_what_happens_while_a_path_is_checked_counts(end: str) -> None:
    async with arms(2) as (_, [arm], record), loop.open_nursery() as nursery:
        await arm.follow()
        path = long_path()

        async def follow() -> None:
            with pytest.raises(ChainError, match="it moves along" if end == "moves" else "by halt"):
                await arm.follow(path)

        nursery.start_soon(follow)
        await loop.checkpoint()
        await loop.checkpoint()
        assert arm.motion is None
        if end == "moves":
            await arm.move([0.1, 0.1])
            assert record.rows[-1] == pytest.approx([0.1, 0.1], abs=3e-6)
        else:
            await arm.halt()
            assert record.rows[-1] == [0.0, 0.0]
