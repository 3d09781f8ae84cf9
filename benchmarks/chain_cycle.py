"""Measure the cost of a chain's cycle in the master alone: SYNC, set-points, and the drives' PDOs.

    python benchmarks/chain_cycle.py            # 6 and 12 joints, 1 ms and 4 ms, 3 rounds each: about a minute
    python benchmarks/chain_cycle.py --profile  # 6 joints at 1 ms: where the time goes

The user's loop is the one of the README: `async for cycle in arm.cycles(): arm.set_positions(...)`. First simulated joints of the
manual's arm are there (powerballs), which the chain brings up and follows for some cycles. Then they go, and a recording takes
their place: at each SYNC every joint "sends" its last TPDO once more, and an SDO request is answered as it was before. So the CPU
time of the process is that of the master, its pump and trio. The clock jumps to the next deadline when no task can run, so the
machine's load does not count. A real transport adds its system calls: two for each frame; and a real clock its timer.
"""

from __future__ import annotations

import argparse
import cProfile
import enum
import gc
import math
import os
import platform
import pstats
import time
from collections.abc import Iterable
from contextlib import nullcontext

import trio
import trio.testing

from canopen_master import Chain, ChainSettings, open_master, powerballs, simulate
from canopen_proto.drives.trajectory import Path, from_function
from canopen_proto.frame import SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, SYNC, TPDO1, Frame
from canopen_proto.machine import SECOND
from canopen_transports import Received, Report, VirtualTransport

WARM_UP = 0.2  # seconds of the path before the recording takes over: each joint's mode was read by then

WHILE_A_THREAD_WORKS = 0.001  # seconds to sleep, which is no CPU time


class Task(enum.Enum):
    """Source of the set-points: the user's loop; a path, whose clock runs in the pump; the same while the chain is recorded."""

    LOOP = enum.auto()
    PATH = enum.auto()
    RECORDED_PATH = enum.auto()


class JumpingClock(trio.abc.Clock):
    """Virtual time as trio's MockClock keeps it, but at no cost: where trio would sleep, the next deadline has already come."""

    def __init__(self) -> None:
        self._now = 0.0

    def start_clock(self) -> None:
        """Do nothing: it stands still until it jumps."""

    def current_time(self) -> float:
        """Seconds."""
        return self._now

    def deadline_to_sleep_time(self, deadline: float) -> float:
        """Jump to the deadline; without one, sleep for ever. While a thread works, time stands still: else a path would be over
        before its recording was opened."""
        if deadline == math.inf:
            return deadline
        if trio.testing.active_thread_count():
            return WHILE_A_THREAD_WORKS
        self._now = max(self._now, deadline)
        return 0.0


class Recorder(VirtualTransport):
    """A bus whose devices are replaced by what they have sent last, from `replay` on."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._is_replaying = False
        self._tpdos: dict[int, Frame] = {}
        self._answers: dict[tuple[int, bytes], Frame] = {}
        self._asked: dict[int, bytes] = {}

    def replay(self) -> None:
        """From now on only the recording answers."""
        self._is_replaying = True

    def push_to(self, receiver: object) -> None:
        """Do nothing: drives in another process cannot push, their frames come by `receive_many`."""

    def send_nowait(self, frame: Frame) -> bool:
        """To the devices, or to the recording."""
        if self._is_replaying:
            self._answer(frame)
            return True
        if frame.can_id & 0x780 == SDO_CLIENT_TO_SERVER:
            self._asked[frame.can_id & 0x7F] = frame.data
        return super().send_nowait(frame)

    def _answer(self, frame: Frame) -> None:
        """A SYNC brings the TPDOs, a request its answer."""
        if frame.can_id == SYNC:
            self._bring(*self._tpdos.values())
        elif frame.can_id & 0x780 == SDO_CLIENT_TO_SERVER:
            answer = self._answers.get((frame.can_id & 0x7F, frame.data))
            if answer is not None:  # else it is one of those that halt the joints in the end
                self._bring(answer)

    async def receive_many(self, limit: int) -> list[Received | Report]:
        """As the bus brings it, recorded while there are devices."""
        received = await super().receive_many(limit)
        for item in () if self._is_replaying else received:
            assert isinstance(item, tuple)
            frame = item[0]
            service, node_id = frame.can_id & 0x780, frame.can_id & 0x7F
            if service == TPDO1:
                self._tpdos[node_id] = frame
            elif service == SDO_SERVER_TO_CLIENT:
                self._answers[node_id, self._asked[node_id]] = frame
        return received

    def _bring(self, *frames: Frame) -> None:
        now = round(trio.current_time() * SECOND)
        for frame in frames:
            self._queue.put((frame, now))
        self._queue.wake()


async def _follow(arm: Chain, start: list[float], cycles: int) -> None:
    """The user's loop: a smooth path so near to the start that joints which stand still follow it."""
    async for cycle in arm.cycles():
        swing = 1e-4 * (1 - math.cos(cycle.time))
        arm.set_positions([position + swing for position in start])
        if cycle.number == cycles:
            return


def _path(start: list[float], seconds: float) -> Path:
    """Return the same path as a spline with a hundred segments a second, from rest to rest."""
    turns = 2 * math.pi * max(1, round(seconds / 6))

    def positions(at: float) -> list[float]:
        swing = 1e-4 * (1 - math.cos(turns * at / seconds))
        return [position + swing for position in start]

    return from_function(positions, seconds, 0.01)


async def _follow_path(arm: Chain, path: Path, scope: trio.CancelScope) -> None:
    """Follow a path until `scope` is cancelled."""
    with scope:
        await arm.follow(path)


async def _work(arm: Chain, start: list[float], cycles: int, task: Task) -> None:
    """Do what is measured."""
    if task is Task.LOOP:
        await _follow(arm, start, cycles)
        return
    async with arm.record(os.devnull) if task is Task.RECORDED_PATH else nullcontext():
        await trio.sleep(cycles * arm.settings.cycle_time)


async def _serve(
    scope: trio.CancelScope, node_ids: Iterable[int], task_status: trio.TaskStatus[object] = trio.TASK_STATUS_IGNORED
) -> None:
    """Simulate the joints until `scope` is cancelled."""
    with scope:
        await simulate(VirtualTransport("arm"), powerballs(*node_ids), task_status=task_status)


async def _measure(joints: int, cycle_time: float, cycles: int, profile: cProfile.Profile | None, task: Task) -> float:
    """ns of CPU time that one cycle takes."""
    node_ids = range(3, 3 + joints)
    drives = trio.CancelScope()
    async with trio.open_nursery() as nursery:
        await nursery.start(_serve, drives, node_ids)
        bus = Recorder("arm")
        async with open_master(bus, watchdog=None) as master:
            text = "arm " + " ".join(f"joint{node_id} arm {node_id}" for node_id in node_ids)
            arm = master.load_chains(text=text, settings=ChainSettings(cycle_time=cycle_time))["arm"]
            await arm.initialise()
            await arm.enable_interpolated_position()
            start = arm.positions
            await _follow(arm, start, max(round(WARM_UP / cycle_time), 2 * joints))
            bus.replay()
            drives.cancel()
            following = trio.CancelScope()
            if task is not Task.LOOP:
                nursery.start_soon(_follow_path, arm, _path(start, (cycles + 200) * cycle_time), following)
                while arm.motion is None:
                    await trio.sleep(cycle_time)
            sent, missed = arm.sync_cycles, arm.missed_cycles
            gc.collect()
            gc.disable()
            begin = time.process_time_ns()
            with profile or nullcontext():
                await _work(arm, start, cycles, task)
            taken = time.process_time_ns() - begin
            gc.enable()
            assert arm.sync_cycles - sent >= cycles - 1, "fewer SYNCs than cycles"
            assert arm.missed_cycles == missed, "a cycle was missed"
            assert task is Task.LOOP or arm.motion is not None, "the path was over"
            following.cancel()
            result = taken / (arm.sync_cycles - sent)
    return result


def cycle(
    joints: int, cycle_time: float, cycles: int = 2000, profile: cProfile.Profile | None = None, task: Task = Task.LOOP
) -> float:
    """ns of CPU time that one cycle of a chain takes its master."""
    return trio.run(_measure, joints, cycle_time, cycles, profile, task, clock=JumpingClock())


def main() -> None:
    """Read the arguments, measure, print."""
    parser = argparse.ArgumentParser(description="what a cycle of a chain costs the master alone")
    parser.add_argument("--rounds", type=int, default=3, help="rounds per case; the least counts (default: 3)")
    parser.add_argument("--profile", action="store_true", help="6 joints at 1 ms under cProfile instead")
    arguments = parser.parse_args()
    if arguments.profile:
        profile = cProfile.Profile()
        cycle(6, 0.001, profile=profile)
        pstats.Stats(profile).sort_stats("cumulative").print_stats(80)
        return
    print(f"{platform.python_implementation()} {platform.python_version()}; least of {arguments.rounds} rounds\n")
    print("| cost of a chain's cycle in the master alone | us of CPU time | share of a core |\n|---|---:|---:|")
    for joints in (6, 12):
        for cycle_time in (0.001, 0.004):
            least = min(cycle(joints, cycle_time) for _ in range(arguments.rounds))
            print(f"| {joints} joints, {cycle_time * 1000:.0f} ms | {least / 1000:.0f} | {least / cycle_time / 1e7:.1f} % |")


if __name__ == "__main__":
    main()
