"""A process that stalls, or a task that is late: no joint exceeds its speed, stays off its path, or stops because of it."""

from __future__ import annotations

import itertools
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import replace

import pytest
import trio
import trio.testing
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_master import Chain, ChainFaultError, ChainHaltedError, Master
from canopen_master.motion.late_sync import WithinReach
from canopen_master.participant.sleeping import SleepWatch, sleep_watch
from canopen_proto.abort import AbortCode
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.machine import SECOND
from canopen_proto.simulation.drive.answers import Answer
from tests.examples import examples
from tests.loops import jump, loop
from tests.master.path_world import AXIS, COUNTS, CYCLE, Record, arms, swing
from tests.master.test_moving import assert_within_limits
from tests.master.test_path_motion import ON_PATH, distance_from, moved
from tests.master.world import drives, virtual_time

SPEED = 1.0
"""Of the joints, at most."""
WAYS = 0.6, -0.3
PATH = swing(*WAYS, duration=1.2)
"""Its first joint goes at 0.938 in the middle: a SYNC that is late and counts as on time (ON_TIME) may add 5 %."""

PATH_OF_ONE = swing(0.6, duration=1.2)

Turn = tuple[bool, float, float]
"""Whether the whole process stalls, with the master in it, or only the task; for how long; and the time until the next turn."""

times = st.one_of(st.just(0.0), st.floats(0.0, 0.02), st.floats(0.0, 0.2))
turns = st.lists(st.tuples(st.booleans(), times, times), min_size=1, max_size=8)


def stall(seconds: float) -> None:
    jump(seconds)


async def late(turns: Sequence[Turn]) -> None:
    for is_process, seconds, pause in turns:
        if is_process:
            stall(seconds)
        else:
            await loop.sleep(seconds)
        await loop.sleep(pause)


@asynccontextmanager
async def watched(record: Record) -> AsyncIterator[list[float]]:
    """The largest speed that any drive had, as the only item of the list."""
    largest = [0.0]

    async def measure() -> None:
        for each in itertools.cycle((0.0019, 0.0032)):
            for host in record.hosts:
                for node in drives(host):
                    node.drive.refresh(host.now())
                    largest[0] = max(largest[0], abs(node.drive._servo.demand_velocity) / COUNTS)
            await loop.sleep(each)

    async with loop.open_nursery() as nursery:
        nursery.start_soon(measure)
        yield largest
        nursery.cancel_scope.cancel()


@pytest.mark.thorough(5)
@pytest.mark.parametrize("mode", [Mode.INTERPOLATED_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION])
@pytest.mark.parametrize("keeps_its_speed", [False, True])
@example([(True, 0.009, 0.2), (True, 0.045, 0.2), (True, 0.015, 0.1), (True, 0.095, 0.2)])
@examples(3, least=2)
@given(turns)
def test_whatever_is_late_no_joint_exceeds_its_speed(mode: Mode, keeps_its_speed: bool, turns: Sequence[Turn]) -> None:
    """keeps_its_speed: the drives limit it themselves (0x607F)."""

    @virtual_time
    async def run() -> None:
        async with arms(2, mode=mode) as (_, [arm], record):
            if keeps_its_speed:
                for node in drives(record.hosts[0]):
                    node.values.store[0x607F_00] = round(SPEED * COUNTS)
            async with watched(record) as largest, loop.open_nursery() as nursery:
                nursery.start_soon(arm.follow, PATH)
                await moved(arm, 0.4)
                await late(turns)
            assert record.rows[-1] == pytest.approx(WAYS, abs=3e-6)
            assert largest[0] <= SPEED
            if not any(is_process and seconds for is_process, seconds, _ in turns):
                assert max(distance_from(PATH, row) for row in record.rows) < ON_PATH
                assert_within_limits(record)

    run()


@pytest.mark.thorough(4)
@pytest.mark.parametrize("mode", [Mode.INTERPOLATED_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION])
@pytest.mark.parametrize("gap", [0.009, 0.035, 0.095, 0.2])
def test_a_loop_that_gives_set_points_keeps_the_speed_too(mode: Mode, gap: float) -> None:
    @virtual_time
    async def run() -> None:
        async with arms(1, mode=mode) as (_, [arm], record), watched(record) as largest:
            await arm.follow()
            async for cycle in arm.cycles():
                arm.set_positions([0.95 * max(0.0, cycle.time - 0.1)])
                if cycle.number == 40:
                    stall(gap)
                if cycle.number == 100:
                    break
            (wanted,) = arm.desired
            await loop.sleep(1.0)
            assert record.rows[-1] == pytest.approx([wanted], abs=3e-6)
            assert 0.94 < largest[0] <= SPEED

    run()


@virtual_time
async def test_chains_on_two_buses_stall_and_go_on_together() -> None:
    async with arms(1, 1) as (_, chains, record), watched(record) as largest:
        async with loop.open_nursery() as nursery:
            for chain, way in zip(chains, WAYS, strict=True):
                nursery.start_soon(chain.follow, swing(way, duration=1.2))
            await moved(chains[0], 0.5)
            stall(0.15)
        assert record.rows[-1] == pytest.approx(WAYS, abs=3e-6)
        assert largest[0] <= SPEED


async def stalled(arm: Chain) -> None:
    await moved(arm, 0.5)
    stall(0.15)
    await loop.sleep(0.005)


@virtual_time
async def test_behind_a_gap_a_joint_comes_back_to_its_path_from_where_it_is() -> None:
    """It has braked beyond its last set-point; the others go on along the path."""
    async with arms(2) as (_, [arm], record), watched(record) as largest, loop.open_nursery() as nursery:
        nursery.start_soon(arm.follow, PATH)
        await stalled(arm)
        assert not arm.is_on_path
        before = len(record.rows)
        while not arm.is_on_path:
            await loop.sleep(0.01)
        await loop.sleep(0.03)
        assert distance_from(PATH, record.rows[before]) > 1000 * ON_PATH
        assert distance_from(PATH, record.rows[-1]) < ON_PATH
        assert largest[0] <= SPEED


@virtual_time
async def test_a_motion_that_is_cancelled_on_the_way_back_ends_on_its_path() -> None:
    async with arms(2) as (_, [arm], record):
        with loop.cancel_scope() as scope:
            async with loop.open_nursery() as nursery:
                nursery.start_soon(arm.follow, PATH)
                await stalled(arm)
                scope.cancel()
        await loop.sleep(CYCLE)
        assert distance_from(PATH, record.rows[-1]) < ON_PATH


@virtual_time
async def test_a_joint_that_does_not_tell_where_it_is_halts_its_chain_before_sync() -> None:
    async with arms(2) as (_, [arm], record), watched(record) as largest:

        async def follow() -> None:
            with pytest.raises(ChainHaltedError, match="SYNC was 1[45]. ms late, and j02 did not tell where it is"):
                await arm.follow(PATH)

        async with loop.open_nursery() as nursery:
            nursery.start_soon(follow)
            await moved(arm, 0.5)
            drives(record.hosts[0])[1].answer(0x6064, 0, Answer(abort=AbortCode.GENERAL_ERROR))
            stall(0.15)
        assert largest[0] <= SPEED


@virtual_time
@pytest.mark.parametrize(("code", "cause"), [(0x2310, "it is in fault: 0x2310"), (0x8611, "our own SYNC was")])
async def test_a_fault_beside_a_late_sync_is_what_the_drive_says_it_is(code: int, cause: str) -> None:
    """Its following error may be our fault; its current is its own affair."""
    async with arms(2) as (_, [arm], record):

        async def follow() -> None:
            with pytest.raises(ChainFaultError) as raised:
                await arm.follow(PATH)
            assert raised.value.cause.startswith(cause), str(raised.value)
            assert "our own SYNC was 1" in raised.value.cause

        async with loop.open_nursery() as nursery:
            nursery.start_soon(follow)
            await moved(arm, 0.5)
            stall(0.02)
            await loop.sleep(0.03)
            drives(record.hosts[0])[1].raise_fault(code, record.hosts[0].now())
            record.hosts[0].pump()


def test_joints_in_reach_are_not_asked() -> None:
    within = WithinReach([0.0, 0.0], [1.0, 1.0])
    assert not within.must_look(1000.0)  # they stand
    for number in (1, 2, 3):
        assert within.next([number * 0.1, number * 0.9]) == [number * 0.1, number * 0.9]
        within.on_sent()
    assert not within.must_look(2.0)
    assert within.must_look(2.2)  # the second one has gone 1.98 of its ways, and would have to come back by 1.08
    within = WithinReach([0.0], [1.0])
    for number in (1, 2, 3):
        within.next([number * 0.1])
        within.on_sent()
    assert not within.must_look(10.9)
    assert within.must_look(11.1)


def test_a_shorter_period_has_a_shorter_step_and_what_is_missing_comes_later() -> None:
    within = WithinReach([0.0, 0.0], [1.0, 1.0])
    assert within.next([1.0, 0.2], share=0.25) == [0.25, 0.2]
    assert within.next([1.0, 0.2], share=0.5) == [0.5, 0.2]  # the same again
    within.on_sent()
    assert not within.is_on_path
    assert within.next([1.0, 0.4]) == pytest.approx([0.7, 0.4])  # 0.2 of its way
    within.on_sent()
    assert within.next([1.6, 0.6]) == pytest.approx([1.5, 0.6])
    within.on_sent()
    assert within.next([1.6, 0.6]) == [1.6, 0.6]
    within.on_sent()
    assert within.is_on_path


@virtual_time
async def test_the_step_behind_a_late_sync_is_as_long_as_the_time_that_is_left_for_it() -> None:
    async with arms(1) as (_, [arm], _):
        await arm.follow()
        points = arm.members[0].set_points
        (start,), (way,) = arm.desired_positions, points.limited.values()
        arm.set_positions([start + way])
        assert arm.desired_positions == pytest.approx([start + way], abs=way / 100)
        for late, share in ((0.75, 0.25), (1.5, 0.5), (3.9, 0.1)):
            points.before_late_sync(round(late * points.period))
            assert arm.desired_positions == pytest.approx([start + share * way], abs=way / 100)


def test_a_joint_without_a_limit_is_left_alone() -> None:
    within = WithinReach([0.0], [float("inf")])
    for number in (1, 2, 3):
        assert within.next([number * 100.0], share=0.1) == [number * 100.0]
        within.on_sent()
    assert not within.must_look(1000.0)


def brake_slowly(record: Record) -> None:
    """Let the drives brake by 2 units per second² without SYNC, and follow again behind up to three seconds."""
    for host in record.hosts:
        for node in drives(host):
            node.values.store.update({0x1006_00: 1_000_000, 0x6085_00: 2_000_000, 0x6084_00: 2_000_000})


@pytest.mark.thorough(3)
@pytest.mark.parametrize("delay", [0.03, 0.1, 10.0])
@pytest.mark.parametrize("joints", [(2,), (1, 1)])
def test_a_slow_answer_of_one_joint_makes_no_other_one_jump(joints: tuple[int, ...], delay: float) -> None:
    """The others go on while it is waited for: where they were when they were asked is far behind them."""

    @virtual_time
    async def run() -> None:
        async with arms(*joints) as (_, chains, record), watched(record) as largest:
            brake_slowly(record)

            async def follow(chain: Chain) -> None:
                with suppress(ChainHaltedError, ChainFaultError):
                    await chain.follow(swing(*WAYS[: len(chain.devices)], duration=1.2))

            async with loop.open_nursery() as nursery:
                for chain in chains:
                    nursery.start_soon(follow, chain)
                await moved(chains[0], 0.5)
                drives(record.hosts[-1])[-1].answer(0x6064, 0, Answer(delay=round(delay * 1e9)))
                stall(0.035)
            assert largest[0] <= SPEED

    run()


@virtual_time
async def test_transfers_with_a_joint_do_not_keep_sync_away() -> None:
    """A halted chain is better than drives without SYNC."""
    async with arms(1, 1) as (_, chains, record):
        brake_slowly(record)
        drives(record.hosts[1])[0].answer(0x1018, 1, Answer(delay=round(0.4e9)))

        async def follow() -> None:
            with pytest.raises(ChainHaltedError, match="j11 did not tell where it is: no answer within 200 ms"):
                await chains[1].follow(PATH_OF_ONE)

        async with loop.open_nursery() as nursery:
            nursery.start_soon(follow)
            await moved(chains[1], 0.5)
            for _ in range(5):
                nursery.start_soon(chains[1].devices[0].node.read, (0x1018, 1))
            await loop.sleep(0.001)
            stall(0.045)
        assert max(after - before for before, after in itertools.pairwise(record.times)) < 0.3


@virtual_time
async def test_on_the_way_back_no_joint_is_sent_beyond_its_position_limit() -> None:
    axis = replace(AXIS, min_position=-1.0, max_position=1.0)
    async with arms(1, axis=axis) as (_, [arm], record):
        await arm.follow()
        async for cycle in arm.cycles():
            arm.set_positions([min(1.0, 0.9 * cycle.time)])
            if cycle.number == 104:
                stall(0.15)
            if cycle.number == 150:
                break
        assert max(row[0] for row in record.rows) <= 1.0 + 2 / COUNTS
        assert record.rows[-1] == pytest.approx([1.0], abs=3e-6)


def test_a_joint_beyond_its_limit_is_not_sent_further() -> None:
    within = WithinReach([0.0], [1.0], [(None, 1.0)])
    within.stand_at([1.5], [0.5])
    assert within.next([0.9]) == [1.5]
    within.on_sent()
    assert within.next([0.9]) == pytest.approx([1.3])


@pytest.mark.thorough(3)
@pytest.mark.parametrize("gap", [0.06, 0.2, 0.4])
@pytest.mark.parametrize("looks", [False, True])
def test_sync_that_is_started_again_lets_no_joint_jump(gap: float, looks: bool) -> None:
    """looks: the joints are being asked where they are, behind a stall."""

    @virtual_time
    async def run() -> None:
        async with arms(2) as (master, [arm], record), watched(record) as largest:
            brake_slowly(record)

            async def follow() -> None:
                with pytest.raises(ChainHaltedError if not looks else (ChainHaltedError, ChainFaultError)):
                    await arm.follow(PATH)

            async with loop.open_nursery() as nursery:
                nursery.start_soon(follow)
                await moved(arm, 0.5)
                if looks:
                    drives(record.hosts[0])[1].answer(0x6064, 0, Answer(delay=round(0.1e9)))
                    stall(gap)
                    await loop.sleep(0.05)
                else:
                    master.sync_stop()
                    await loop.sleep(gap)
                master.sync_start(CYCLE)
            assert largest[0] <= SPEED

    run()


async def follow_path(arm: Chain) -> None:
    await arm.follow(PATH)


async def stream_on(arm: Chain) -> None:
    async with arm.stream() as targets:
        while True:
            targets.aim_at(WAYS)
            await loop.sleep(0.005)


async def loop_on(arm: Chain) -> None:
    async for cycle in arm.cycles():
        arm.set_positions([way * min(1.0, cycle.time) for way in WAYS])


async def stand(arm: Chain) -> None:
    async for _ in arm.cycles():
        arm.hold()


def jumps(master: Master, seconds: float) -> None:
    """On Windows, or in a virtual machine that was held."""
    stall(seconds)


def sleeps(master: Master, seconds: float) -> None:
    """On Linux, whose clock stands still meanwhile. Nothing shows that time has passed: no frame is missing, none is late."""
    since_boot = [0]
    master._sleep_watch = SleepWatch(lambda: since_boot[0], lambda: 0)
    since_boot[0] = round(seconds * SECOND)


@pytest.mark.thorough(4)
@pytest.mark.parametrize("passes", [jumps, sleeps])
@pytest.mark.parametrize("seconds", [1.2, 3600.0])
@pytest.mark.parametrize("moves", [follow_path, stream_on, loop_on, stand])
def test_no_chain_goes_on_by_itself_when_the_computer_has_slept(
    moves: Callable[[Chain], Awaitable[None]], seconds: float, passes: Callable[[Master, float], None]
) -> None:
    """A laptop is opened again: nobody expects the arm to move, and somebody may stand in its way."""

    @virtual_time
    async def run() -> None:
        async with arms(2) as (master, [arm], record), watched(record) as largest:
            if moves is not follow_path:
                await arm.follow()

            async def fall_asleep() -> None:
                await loop.sleep(0.5)
                passes(master, seconds)

            async with loop.open_nursery() as nursery:
                nursery.start_soon(fall_asleep)
                with pytest.raises(ChainHaltedError) as halted:
                    await moves(arm)
            assert f"no SYNC was sent for {seconds:.1f} s: this program, or its computer, stood still" in str(halted.value)
            await loop.sleep(1.0)
            stood = record.rows[-1]
            await loop.sleep(2.0)
            assert record.rows[-1] == stood
            assert largest[0] <= SPEED
            await arm.follow()
            await arm.move(WAYS)
            assert record.rows[-1] == pytest.approx(WAYS, abs=3e-5)

    run()


@virtual_time
async def test_a_sleep_before_the_motion_is_over_when_it_begins() -> None:
    async with arms(1) as (master, [arm], record):
        master.sync_stop()
        sleeps(master, 3600.0)
        await arm.follow(PATH_OF_ONE)
        assert record.rows[-1] == pytest.approx([0.6], abs=3e-6)


def test_how_long_the_computer_slept() -> None:
    going_on, standing_still = 5_000, 1_000
    watch = SleepWatch(lambda: going_on, lambda: standing_still)
    found = []
    for both, slept in ((10, 0), (10, 700), (10, 0), (0, -3)):  # the two clocks are read one behind the other
        going_on, standing_still = going_on + both + slept, standing_still + both
        found.append(watch.slept())
    assert found == [0, 700, 0, 0]


def test_a_stall_between_the_looks_at_the_two_clocks_is_told_once_and_at_once() -> None:
    """Else the next SYNC, which is on time, would count as late."""
    now, stalls = 1_000, [0, 0, 500, 0]

    def clock() -> int:
        nonlocal now
        found, now = now, now + (stalls.pop(0) if stalls else 0)
        return found

    watch = SleepWatch(clock, clock)
    assert [watch.slept() for _ in range(3)] == [500, 0, 0]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not have these two clocks")
def test_the_clocks_of_this_computer_are_watched_in_real_time_alone() -> None:
    async def watch() -> SleepWatch | None:
        return sleep_watch()

    found = trio.run(watch)
    assert found is not None
    assert found.slept() < SECOND
    assert trio.run(watch, clock=trio.testing.MockClock()) is None
