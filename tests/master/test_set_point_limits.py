"""Limits are on by default: no set-point leaves that asks a drive for more than it, its settings or the default allow."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_master import Chain, Host, Master, SetPointRefusedError, open_master, standard_drives
from canopen_master.direct.drive import COUNTS, STEPS, DirectDrive
from canopen_proto.drives.axis.axis import AxisSettings
from canopen_proto.drives.axis.limits import DEFAULT_SPEED
from canopen_proto.drives.cia402.states import State
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_transports import open_transport
from tests.examples import examples
from tests.loops import loop
from tests.master.world import BUS, arm_of, drives, following_arm, simulated, virtual_time

DEGREES = AxisSettings(counts_per_unit=1000)
"""What the simulated drives count are millidegrees; they stand at 3 degrees."""
HERE = 3000


@asynccontextmanager
async def following_drive(axis: AxisSettings, values: dict[int, int] | None = None) -> AsyncIterator[tuple[Host, Chain]]:
    """A standard drive with these values in its objects, that follows set-points."""
    async with simulated(makers=standard_drives(3)) as host, open_master(BUS) as master:
        master.node(3, drive_dictionary())
        drives(host)[0].values.store.update(values or {})
        arm = arm_of(master, 3, axes=axis, own_pdos=True)
        await arm.initialise()
        await arm.enable_interpolated_position()
        yield host, arm


MAKERS_LIMITS = {0x607D_01: -90_000, 0x607D_02: 170_000, 0x607F_00: 50_000, 0x60C5_00: 100_000}
REFUSED: dict[str, tuple[AxisSettings, dict[int, int], float, tuple[str, ...]]] = {
    "default": (DEGREES, {}, 4, ("from 3 that is 100 per second, more than 30: the default", "max_speed=")),
    "drive": (DEGREES, MAKERS_LIMITS, 4, ("100 per second, more than 50: 0x607F of the drive", "max_speed=")),
    "settings": (replace(DEGREES, max_speed=80.0), MAKERS_LIMITS, 4, ("more than 80: the settings (max_speed)",)),
    "highest of the drive": (
        replace(DEGREES, max_speed=math.inf), MAKERS_LIMITS, 171, ("it is above 170: 0x607D:02 of the drive",),
    ),
    "lowest of the drive": (
        replace(DEGREES, max_speed=math.inf), MAKERS_LIMITS, -91, ("it is below -90: 0x607D:01 of the drive",),
    ),
    "highest, mounted the other way round": (
        replace(DEGREES, max_speed=math.inf, direction=-1), MAKERS_LIMITS, 91, ("it is above 90: 0x607D:01 of the drive",),
    ),
    "lowest, with an offset": (
        replace(DEGREES, max_speed=math.inf, offset=10_000), MAKERS_LIMITS, -101, ("it is below -100: 0x607D:01 of the drive",),
    ),
    "highest of the settings": (
        replace(DEGREES, max_speed=math.inf, max_position=20.0), MAKERS_LIMITS, 21, ("above 20: the settings (max_position)",),
    ),
    "no scale": (AxisSettings(), {}, HERE, ("the joint has no scale", "AxisSettings(counts_per_unit=...)")),
    "out of the numbers": (DEGREES, {}, 1e308, ()),
}  # fmt: skip


@pytest.mark.thorough(2)
@pytest.mark.parametrize("case", REFUSED)
@virtual_time
async def test_the_error_names_joint_value_limit_and_source(case: str) -> None:
    axis, values, target, words = REFUSED[case]
    async with following_drive(axis, values) as (_, arm):
        before = arm.desired_positions
        with pytest.raises(SetPointRefusedError) as caught:
            arm.set_positions([target])
        for word in (f"set-point {target} of joint1 was refused", *words):
            assert word in str(caught.value)
        assert caught.value.joint == "joint1"
        assert arm.desired_positions == before


@virtual_time
async def test_what_a_joint_may_be_asked_for_is_shown() -> None:
    async with following_drive(DEGREES, MAKERS_LIMITS) as (_, arm):
        limits = arm.devices[0].limits
        assert [limit and limit.value for limit in (limits.lowest, limits.highest, limits.speed, limits.acceleration)] == [
            -90, 170, 50, 100,
        ]  # fmt: skip


@virtual_time
async def test_limits_are_read_again_with_each_start() -> None:
    async with following_drive(DEGREES) as (host, arm):
        assert arm.devices[0].limits.highest is None
        await arm.halt()
        drives(host)[0].values.store[0x607D_02] = 5_000
        await arm.enable_interpolated_position()
        assert arm.devices[0].limits.highest == (5, "0x607D:02 of the drive")


@virtual_time
async def test_a_joint_that_stands_outside_may_come_back() -> None:
    async with following_drive(replace(DEGREES, max_position=2.0)) as (_, arm):
        arm.set_positions([3.0])
        with pytest.raises(SetPointRefusedError, match="above 2"):
            arm.set_positions([3.1])
        arm.set_positions([2.5], cycles=2)
        await loop.sleep(0.03)
        with pytest.raises(SetPointRefusedError, match="above 2"):
            arm.set_positions([2.6])
        arm.set_positions([2.4])


@virtual_time
async def test_a_slow_joint_with_few_counts_does_not_go_faster_for_its_rounding() -> None:
    """A count is more than the speed limit allows in a cycle; so a set-point is one, now and then."""
    async with following_drive(AxisSettings(counts_per_unit=1.0, max_speed=10.0)) as (_, arm):
        start = arm.positions[0]
        async for cycle in arm.cycles():
            arm.set_positions([start + 10 * cycle.time])
            if cycle.time > 1:
                break
        with pytest.raises(SetPointRefusedError, match="more than 10: the settings"):
            arm.set_positions([start + 10 * cycle.time + 1])


Try = tuple[float, int]
"""A set-point in degrees, from where the joint stands; and in how many cycles."""
tries = st.lists(st.tuples(st.floats(-2, 2), st.integers(1, 5)), min_size=1, max_size=15)


@examples(10)
@given(tries, st.sampled_from([1, -1]))
def test_whatever_is_asked_no_set_point_leaves_that_is_too_far_from_the_last(tries: list[Try], direction: int) -> None:
    @virtual_time
    async def run() -> None:
        axis = replace(DEGREES, direction=direction, max_position=direction * 3 + 1.0)
        sent = [HERE]
        async with following_drive(axis) as (_, arm), await open_transport(BUS) as spy, loop.open_nursery() as nursery:

            async def listen() -> None:
                while True:
                    frame, _ = await spy.receive()
                    if frame.can_id == 0x503:
                        sent.append(int.from_bytes(frame.data[2:6], "little", signed=True))

            nursery.start_soon(listen)
            for offset, cycles in tries:
                try:
                    arm.set_positions([direction * 3 + offset], cycles=cycles)
                except SetPointRefusedError:
                    arm.hold()
                await loop.sleep(0.01)
            await loop.sleep(0.06)
            nursery.cancel_scope.cancel()
        assert len(sent) > len(tries)
        assert max(abs(after - before) for before, after in pairwise(sent)) <= DEFAULT_SPEED / 100 + 1
        assert all(count * direction <= direction * HERE + 1000 for count in sent)

    run()


@asynccontextmanager
async def directly_driven() -> AsyncIterator[tuple[Master, DirectDrive]]:
    """A joint that follows the set-points of the blocking API, each 10 ms; without its thread, in virtual time."""
    async with simulated(3), open_master(BUS) as master:
        device = master.device(master.node(3), settings=COUNTS)
        drive = DirectDrive(master, device, "schunk_default_rPDO", "schunk_default_tPDO")
        await master.nmt_start(3)
        await drive.change_state(State.OPERATION_ENABLED)
        await drive.follow()
        yield master, drive


steps = st.lists(st.sampled_from([-400, -300, 50, 100, 290, 300, 300, 301]), min_size=1, max_size=2 * STEPS)


@examples(10)
@given(steps, st.sampled_from([0.001, 0.003, 0.008, 0.01, 0.03]))
def test_send_pos_lets_no_set_point_through_that_is_too_fast(steps: list[int], period: float) -> None:
    """Neither for the interval that the drive was told, nor by the clock, for SYNCs that come sooner; and staying is allowed."""

    @virtual_time
    async def run() -> None:
        async with directly_driven() as (master, drive):
            taken = [(loop.current_time(), HERE)]
            for step in steps:
                position = taken[-1][1] + step
                try:
                    await drive.send_position(position)
                except SetPointRefusedError as refused:
                    assert refused.joint == "node 3"
                    position -= step
                    await drive.send_position(position)
                await loop.sleep(period)
                await master.send_sync()
                taken.append((loop.current_time(), position))
        assert max(abs(after - before) for (_, before), (_, after) in pairwise(taken)) <= DEFAULT_SPEED / 100
        for number in range(1, len(taken)):
            (then, start), (_, last), (now, position) = taken[max(0, number - STEPS)], taken[number - 1], taken[number]
            if abs(position - start) > abs(last - start):
                assert abs(position - start) <= DEFAULT_SPEED * (now - then + 0.01)

    run()


@virtual_time
async def test_send_pos_within_its_limits_is_never_refused() -> None:
    """The manual's own path, and faster ones once they are allowed."""
    async with directly_driven() as (master, drive):
        for step in range(1, 101):
            await drive.send_position(HERE + 300 * step)
            await master.send_sync()
            await loop.sleep(0.01)
        with pytest.raises(SetPointRefusedError, match="60000 per second, more than 30000: the default"):
            await drive.send_position(HERE + 300 * 102)
        await drive.set_max_speed(60_000)
        await drive.send_position(HERE + 300 * 102)
        with pytest.raises(SetPointRefusedError, match="more than 60000: the settings"):
            await drive.send_position(HERE + 300 * 102 + 1)


@virtual_time
async def test_the_manuals_arm_follows_the_manuals_paths() -> None:
    """100 millidegrees in 10 ms, without a word about limits."""
    async with following_arm(3) as (_, _, arm):
        (start,) = arm.positions
        async for cycle in arm.cycles():
            arm.set_positions([start + math.radians(10) * cycle.time])
            if cycle.number == 20:
                break


@virtual_time
async def test_set_points_may_be_numbers_of_any_kind() -> None:
    """As those of numpy, not all of which are floats. The compiled core takes nothing else."""
    axis, values, _, _ = REFUSED["settings"]
    async with following_drive(axis, values) as (_, arm):
        before = arm.desired_positions
        for each in (Fraction(before[0]), round(before[0])):
            arm.set_positions([each])
            assert [(type(each), each) for each in arm.desired_positions] == [(float, before[0])]
