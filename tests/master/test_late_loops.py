"""A late loop slows its path, it never catches up: whatever is late, no set-point orders more than the path's own speed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_master import Cycle
from canopen_master.motion.late_sync import RETURN
from canopen_proto.drives.axis.limits import DEFAULT_SPEED
from canopen_transports import open_transport
from tests.examples import examples
from tests.loops import jump, loop
from tests.master.world import BUS, following_arm, virtual_time

CYCLE = 0.01
SPEED = 0.2
"""Of the path, in radians per second."""
STEP = math.degrees(SPEED * CYCLE) * 1000
"""Of the path from one period to the next, in the counts of the drive."""
SET_POINTS = 0x203

Path = Callable[[Cycle], float]
PATHS: dict[str, Path] = {
    "a line over cycle.time": lambda cycle: SPEED * cycle.time,
    "a swing over cycle.time": lambda cycle: SPEED / 20 * math.sin(20 * cycle.time),
    "a line over cycle.number": lambda cycle: SPEED * CYCLE * cycle.number,
}

Delay = tuple[bool, float]
"""Whether it stops the whole process, with the master in it; and for how long."""

SHORT = [0.0, 0.0, 0.001, 0.004, 0.0099, 0.01, 0.012]
"""Two in a row leave the drive within reach of its next set-point: see test_stalls.py for longer ones of the whole process."""
delays = st.tuples(st.just(True), st.sampled_from(SHORT)) | st.tuples(st.just(False), st.sampled_from([*SHORT, 0.045, 0.095]))
turns = st.lists(st.tuples(delays, delays), min_size=1, max_size=12)


async def wait(delay: Delay) -> None:
    blocks, seconds = delay
    if blocks:
        jump(seconds)
    else:
        await loop.sleep(seconds)


async def sent_along(path: Path, turns: Sequence[tuple[Delay, Delay]]) -> tuple[list[int], list[Cycle], float]:
    """The set-points on the bus, the cycles of the loop, and what it took in all. turns: delays before and after giving."""
    cycles = []
    async with following_arm(3, max_missed_cycles=10**6) as (_, _, arm), await open_transport(BUS) as spy:
        (start,) = arm.positions
        sent = [round(math.degrees(start) * 1000)]
        async with loop.open_nursery() as nursery:

            async def listen() -> None:
                while True:
                    frame, _ = await spy.receive()
                    if frame.can_id == SET_POINTS:
                        sent.append(int.from_bytes(frame.data[4:8], "little", signed=True))

            nursery.start_soon(listen)
            began = 0.0
            async for cycle in arm.cycles():
                began = began or loop.current_time()
                cycles.append(cycle)
                if cycle.number == len(turns):
                    break
                before, after = turns[cycle.number]
                await wait(before)
                arm.set_positions([start + path(cycle)])
                await wait(after)
            took = loop.current_time() - began
            await loop.sleep(3 * CYCLE)
            nursery.cancel_scope.cancel()
    return sent, cycles, took


@pytest.mark.thorough(3)
@pytest.mark.parametrize("path", PATHS)
@example([((False, 0.0), (False, 0.0)), ((False, 0.095), (False, 0.0)), ((False, 0.0), (False, 0.0))])
@example([((True, 0.009), (False, 0.0)), ((False, 0.0), (True, 0.012)), ((False, 0.0), (False, 0.0))])
@examples(6)
@given(turns)
def test_whatever_is_late_never_a_step_larger_than_the_paths_own(path: str, turns: list[tuple[Delay, Delay]]) -> None:
    @virtual_time
    async def run() -> None:
        sent, cycles, took = await sent_along(PATHS[path], turns)
        stalls = any(blocks and seconds for turn in turns for blocks, seconds in turn)
        back = RETURN * DEFAULT_SPEED * CYCLE if stalls else 0  # what a shorter period has cut off comes later
        assert max(abs(after - before) for before, after in pairwise(sent)) <= STEP + back + 1  # a count of rounding
        assert [cycle.number for cycle in cycles] == list(range(len(turns) + 1))
        assert [cycle.time for cycle in cycles] == pytest.approx([CYCLE * cycle.number for cycle in cycles])
        # what the path lost is told, to the period: each cycle is handed out within one of its SYNC
        assert took - cycles[-1].time - cycles[-1].late == pytest.approx(0, abs=1.01 * CYCLE)

    run()


@virtual_time
async def test_a_loop_that_holds_stops_its_path_and_is_not_late() -> None:
    async with following_arm(3) as (_, _, arm):
        (start,) = arm.positions
        given, seen = [], []
        async for cycle in arm.cycles():
            seen.append((cycle.number, round(cycle.time, 6), cycle.skipped, cycle.late))
            if 2 <= cycle.number < 5:
                arm.hold()
            else:
                given.append(cycle.time)
                arm.set_positions([start + SPEED * cycle.time])
            if cycle.number == 6:
                break
        assert seen == [(number, round(time, 6), 0, 0) for number, time in enumerate((0, 0.01, 0.02, 0.02, 0.02, 0.02, 0.03))]
        assert given == pytest.approx([0, 0.01, 0.02, 0.03])


@virtual_time
async def test_a_line_over_several_cycles_advances_the_path_by_all_of_them() -> None:
    async with following_arm(3) as (_, _, arm):
        (start,) = arm.positions
        seen = []
        async for cycle in arm.cycles():
            if cycle.number == 0:
                arm.set_positions([start + 0.01], cycles=5)
            seen.append(round(cycle.time, 6))
            if cycle.number == 1:
                await loop.sleep(0.05)
                arm.hold()
            if cycle.number == 2:
                break
        assert seen == [0, 0.01, 0.05]


@pytest.mark.thorough(3)
@pytest.mark.parametrize("at", range(7))
def test_a_hold_ends_a_line_over_several_cycles(at: int) -> None:
    """Whatever was sent when it holds stays, and so does the time."""

    @virtual_time
    async def run() -> None:
        async with following_arm(3) as (_, _, arm):
            (start,) = arm.positions
            seen = []
            async for cycle in arm.cycles():
                if cycle.number == 0:
                    arm.set_positions([start + 0.01], cycles=5)
                if cycle.number >= at:
                    arm.hold()
                seen.append((round(arm.desired_positions[0] - start, 4), round(cycle.time, 6)))
                if cycle.number == 9:
                    break
            sent = min(at, 5)
            assert seen[at:] == [(0.002 * sent, 0.01 * sent)] * (10 - at)
            assert arm.missed_cycles == max(0, at - 5)

    run()
