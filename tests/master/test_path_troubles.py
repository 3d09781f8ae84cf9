"""What ends a motion on a path from outside: a joint in trouble, the end of the master, Ctrl-C, a process that stalls."""

from __future__ import annotations

import signal
from dataclasses import replace

import pytest

from canopen_master import (
    AxisSettings,
    ChainError,
    ChainFaultError,
    ChainHaltedError,
    ChainState,
    MasterClosedError,
    open_master,
    together,
)
from canopen_proto.abort import AbortCode
from canopen_proto.drives.axis import TakenOverError, run_at
from canopen_proto.machine import MILLISECOND
from canopen_proto.simulation.drive.answers import Answer
from canopen_transports.loop import protected
from tests.loops import ends_by_interrupt, fail_after, jump, loop
from tests.master.direct_world import patient
from tests.master.path_world import AXIS, COUNTS, Record, arms, demands, swing
from tests.master.test_moving import assert_within_limits
from tests.master.test_path_motion import ON_PATH, distance_from, moved
from tests.master.world import BUS, arm_of, drives, simulated, virtual_time

PATH = swing(0.5, -0.25, duration=2.0)


def assert_on_path(record: Record) -> None:
    assert max(distance_from(PATH, row) for row in record.rows) < ON_PATH
    assert_within_limits(record)


@virtual_time
async def test_a_joint_that_falls_behind_stops_all_on_the_path() -> None:
    async with arms(2, axis=replace(AXIS, following_error_limit=0.02)) as (_, [arm], record):
        for node in drives(record.hosts[0]):
            node.values.store[0x6065_00] = 0xFFFF_FFFF  # no fault because of it
        async with loop.open_nursery() as nursery:

            async def follow() -> None:
                with pytest.raises(ChainFaultError, match="j02 .* off its path"):
                    await arm.follow(PATH)

            nursery.start_soon(follow)
            await moved(arm, 0.6)
            node = drives(record.hosts[0])[1]
            node.block(True, record.hosts[0].now())
        node.block(False, record.hosts[0].now())
        assert arm.state is ChainState.FAULT
        assert_on_path(record)  # what the drives were told, the blocked one, too
        assert 0.1 < record.rows[-1][0] < 0.5


@virtual_time
async def test_a_fault_stops_each_joint_by_its_own_ramp() -> None:
    async with arms(2) as (_, [arm], record):
        async with loop.open_nursery() as nursery:

            async def follow() -> None:
                with pytest.raises(ChainFaultError, match="j02 .* fell into fault"):
                    await arm.follow(PATH)

            nursery.start_soon(follow)
            await moved(arm, 1.0)
            host = record.hosts[0]
            drives(host)[1].raise_fault(0x3220, host.now())
            host.pump()
            failed = loop.current_time()
        assert arm.state is ChainState.FAULT
        moving = [time for time, row in zip(record.times, record.derivatives(1), strict=False) if abs(row[0]) > 1e-3]
        assert moving[-1] - failed < 0.2  # by its ramp: from full speed in 0.1 s


@virtual_time
async def test_the_end_of_the_master_is_a_stop_on_the_path() -> None:
    async with loop.open_nursery() as nursery, arms(2) as (_, [arm], record):

        async def follow() -> None:
            with pytest.raises(MasterClosedError):
                await arm.follow(PATH)

        nursery.start_soon(follow)
        await moved(arm, 0.6)
    assert 0.1 < record.rows[-1][0] < 0.5
    assert record.rows[-1] == record.rows[-3]
    assert_on_path(record)


@pytest.mark.parametrize("ramp", [10.0, 0.3])
@virtual_time
async def test_the_end_of_the_master_halts_a_drive_off_the_path_at_once(ramp: float) -> None:
    """It does not wait until the chains have come to rest on their paths, and goes on if it needs longer than they do."""
    speed = 0.5
    async with loop.open_nursery() as nursery:
        async with arms(1, 1) as (master, [arm, other], record):

            async def follow() -> None:
                with pytest.raises(MasterClosedError):
                    await arm.follow(swing(0.5))

            async def run() -> None:
                with pytest.raises((MasterClosedError, TakenOverError)):
                    await master.run(run_at(other.devices[0].axis, speed, acceleration=10.0, deceleration=ramp))

            nursery.start_soon(follow)
            nursery.start_soon(run)
            await moved(arm, 0.8)
            left = loop.current_time()
        assert record.times[-1] - left > 0.2  # the arm needs its time
        before = next(row[1] for time, row in zip(record.times, record.rows, strict=True) if time > left)
        [demand] = demands(record.hosts[1])
        assert 0.0 < demand / COUNTS - before < speed * 0.02 + speed**2 / 2 / ramp  # two cycles until it is told, and its ramp
        assert max(abs(row[0]) for row in record.derivatives(2)) < AXIS.max_acceleration  # it braked along the path


@virtual_time
async def test_a_shut_down_is_a_stop_on_the_path() -> None:
    async with arms(2) as (_, [arm], record), loop.open_nursery() as nursery:

        async def follow() -> None:
            with pytest.raises(ChainHaltedError):
                await arm.follow(PATH)

        nursery.start_soon(follow)
        await moved(arm, 0.6)
        await arm.shut_down()
        assert arm.state is ChainState.OFF
        assert_on_path(record)


@virtual_time
async def test_ctrl_c_is_a_stop_on_the_path() -> None:
    @protected
    async def press() -> None:
        await moved(arm, 0.6)
        signal.raise_signal(signal.SIGINT)

    with ends_by_interrupt():
        async with arms(2) as (_, [arm], record), loop.open_nursery() as nursery:
            nursery.start_soon(press)
            await arm.follow(PATH)
    assert 0.1 < record.rows[-1][0] < 0.5
    assert_on_path(record)


@virtual_time
async def test_a_halt_without_sync_does_not_wait_for_the_path() -> None:
    """Drives that hold on without SYNC would else stay without a halt as long as a stop on the path may take."""
    async with arms(2, makers=patient) as (master, [arm], _), loop.open_nursery() as nursery:

        async def follow() -> None:
            with pytest.raises(ChainHaltedError, match="by halt"):
                await arm.follow(PATH)

        nursery.start_soon(follow)
        await moved(arm, 0.6)
        master.sync_stop()
        began = loop.current_time()
        await arm.halt()
        assert loop.current_time() - began < 2.0
        assert arm.state is ChainState.HALTED


@pytest.mark.parametrize("ends", ["it fails", "it is cancelled"])
@virtual_time
async def test_a_halt_of_several_chains_stops_each_of_them_whatever_becomes_of_the_others(ends: str) -> None:
    async with arms(1, 1) as (_, [arm, leg], record), loop.open_nursery() as nursery:
        both = together(arm, leg)
        await arm.follow()

        async def follow() -> None:
            with pytest.raises(ChainHaltedError, match="by halt"):
                await leg.follow(swing(0.9, duration=4.0))

        nursery.start_soon(follow)
        await moved(leg, 1.0)
        if ends == "it fails":
            drives(record.hosts[0])[0].answer(0x6041, 0, Answer(abort=AbortCode.GENERAL_ERROR))
            with pytest.raises(ChainError, match="j01"):
                await both.halt()
        else:
            with loop.cancel_scope() as scope:
                scope.cancel()
                await both.halt()
        while leg.motion is not None:
            assert leg.motion.is_braking
            await loop.sleep(0.01)
        drives(record.hosts[0])[0].answer(0x6041, 0, None)


@pytest.mark.parametrize(("late", "least", "most"), [(0.025, 0.005, 0.05), (0.055, 0.15, 1.0)])
def test_only_behind_a_long_gap_a_path_goes_on_from_rest(late: float, least: float, most: float) -> None:
    """A computer that skips single SYNCs would otherwise make joints crawl. least, most: by how much the motion takes longer."""
    ends: list[float] = []

    @virtual_time
    async def run(gap: float) -> None:
        async with arms(2) as (_, [arm], _):
            async with loop.open_nursery() as nursery:
                nursery.start_soon(arm.follow, PATH)
                await moved(arm, 0.8)
                begun = loop.current_time()
                jump(gap)
            ends.append(loop.current_time() - begun)

    run(0.0)
    run(late)
    assert least < ends[1] - ends[0] < most


@virtual_time
async def test_a_shut_down_leaves_sync_to_a_chain_that_initialises() -> None:
    """It would go ready without SYNC else, and a motion of it would never end."""
    async with arms(1, 1) as (_, [arm, leg], record):
        await leg.shut_down()
        drives(record.hosts[1])[0].answer(0x6060, 0, Answer(delay=300 * MILLISECOND))
        async with loop.open_nursery() as nursery:
            nursery.start_soon(leg.initialise)
            await loop.sleep(0.01)
            await arm.shut_down()
        with fail_after(10.0):
            await leg.move([0.1])
        assert record.rows[-1] == pytest.approx([0.0, 0.1], abs=3e-6)


@virtual_time
async def test_the_task_that_moves_a_chain_is_not_woken_in_each_cycle() -> None:
    async with simulated(3, 4), open_master(BUS) as master, loop.open_nursery() as nursery:
        arm = arm_of(master, 3, 4)
        await arm.initialise()
        await arm.follow()
        nursery.start_soon(arm.move, [0.2, 0.2])
        while arm.motion is None:
            await loop.sleep(0.001)
        motion = arm.motion
        for _ in range(20):
            await loop.sleep(0.01)
            assert not motion.news  # nobody waits for the next cycle
        assert motion.cycles > 5
        await arm.next_news()  # who asks for each cycle is woken


@pytest.mark.parametrize("after", [0.0, 0.3])
@virtual_time
async def test_a_motion_does_not_wait_for_ever_for_a_sync_that_was_stopped(after: float) -> None:
    """These drives do not notice: only the master can end it. `follow` sends SYNC again."""
    axis = AxisSettings(counts_per_unit=1000, max_speed=20.0, max_acceleration=50.0, max_jerk=500.0)
    async with simulated(3, 4), open_master(BUS) as master, loop.open_nursery() as nursery:
        arm = arm_of(master, 3, 4, axes=axis)
        await arm.initialise()
        await arm.follow()
        begun = loop.current_time()

        async def stop() -> None:
            await loop.sleep(after)
            master.sync_stop()

        nursery.start_soon(stop)
        with pytest.raises(ChainHaltedError, match="no SYNC came for 0.5 s or more"):
            await arm.move([5.0, 5.0])
        assert loop.current_time() - begun < after + 1.2  # 0.5 s, and the halt
        assert arm.state is ChainState.HALTED
        await arm.follow()
        await arm.move([5.0, 5.0])
        assert arm.positions == pytest.approx([5.0, 5.0], abs=0.01)
