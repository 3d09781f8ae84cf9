"""What only asyncio has: its own ways to cancel, its Ctrl-C, generators, foreign awaits; and the drives stand in each case."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import aclosing, suppress
from typing import Any

import pytest

from canopen_master import Chain, Host, open_master, powerballs, simulate
from canopen_proto import LocalProtocolError
from canopen_proto.frame import Frame
from canopen_proto.network import Network
from canopen_proto.procedures import read
from canopen_testing.world_loop import WorldLoop
from canopen_transports import Received, VirtualTransport, open_transport
from canopen_transports.loop import TaskStatus
from tests import loops
from tests.loops import ASYNCIO, loop
from tests.master.world import BUS, arm_of, assert_all_halted, assert_all_stand, drives, position_of, simulated

TIMES = (0.004, 0.021, 0.1, 0.7, 1.64)
"""Seconds: the joints are initialised at first, and then homed."""


@pytest.fixture(autouse=True)
def on_asyncio(on_loop: None) -> None:
    """After the fixture of conftest.py, which chooses the loop."""
    loops.chosen = ASYNCIO


def run(test: Callable[[], Awaitable[Any]]) -> Any:
    return loops.run(test)


async def home(arm: Chain) -> None:
    await arm.initialise()
    await arm.home()
    await asyncio.sleep(1000)


async def check(host: Host) -> None:
    assert_all_halted(host)
    await assert_all_stand(host)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("seconds", TIMES)
def test_a_timeout_of_asyncio_around_the_master(seconds: float) -> None:
    async def test() -> None:
        async with simulated(3, 4) as host:
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(seconds), open_master(BUS) as master:
                    await home(arm_of(master, 3, 4))
            await check(host)

    run(test)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("seconds", TIMES)
def test_a_timeout_of_asyncio_within_the_master(seconds: float) -> None:
    async def test() -> None:
        async with simulated(3, 4) as host:
            async with open_master(BUS) as master:
                arm = arm_of(master, 3, 4)
                with pytest.raises(TimeoutError):
                    async with asyncio.timeout(seconds):
                        await home(arm)
                before = [position_of(host, node) for node in drives(host)]
                await asyncio.sleep(1)  # what had begun was halted at once, and not at the end of the master
                assert [position_of(host, node) for node in drives(host)] == before or seconds > 1.6
                assert await master.node(3).read("device_type") == 0x20192
            await check(host)

    run(test)


@pytest.mark.thorough(6)
@pytest.mark.parametrize("again", [None, 0.0, 0.001, 0.02])
@pytest.mark.parametrize("seconds", TIMES)
def test_a_task_that_is_cancelled_from_outside_once_or_again(seconds: float, again: float | None) -> None:
    async def test() -> None:
        async with simulated(3, 4) as host:

            async def work() -> None:
                async with open_master(BUS) as master:
                    await home(arm_of(master, 3, 4))

            task = asyncio.create_task(work())
            await asyncio.sleep(seconds)
            task.cancel()
            if again is not None:
                await asyncio.sleep(again)
                task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            await check(host)

    run(test)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("seconds", TIMES)
def test_a_task_group_that_fails_beside_the_master(seconds: float) -> None:
    async def test() -> None:
        async with simulated(3, 4) as host:

            async def fail() -> None:
                await asyncio.sleep(seconds)
                raise ValueError("beside")

            with pytest.raises(ExceptionGroup) as caught:
                async with asyncio.TaskGroup() as group:
                    group.create_task(fail())
                    async with open_master(BUS) as master:
                        await home(arm_of(master, 3, 4))
            assert [str(error) for error in caught.value.exceptions] == ["beside"]
            await check(host)

    run(test)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("seconds", TIMES)
def test_a_task_group_within_the_master_moves_two_arms_and_one_fails(seconds: float) -> None:
    async def test() -> None:
        async with simulated(3, 4) as host:

            async def fail() -> None:
                await asyncio.sleep(seconds)
                raise ValueError("within")

            with pytest.raises(ExceptionGroup) as caught:
                async with open_master(BUS) as master, asyncio.TaskGroup() as group:
                    chains = master.load_chains(text="left j3 can0 3\nright j4 can0 4\n")
                    for chain in chains.values():
                        group.create_task(home(chain))
                    group.create_task(fail())
            assert [str(error) for error in caught.value.exceptions] == ["within"]
            await check(host)

    run(test)


async def positions() -> AsyncIterator[list[float]]:
    """A generator that holds a master open between its values."""
    async with open_master(BUS) as master:
        arm = arm_of(master, 3)
        await arm.initialise()
        await arm.enable_interpolated_position()
        (start,) = arm.positions
        async for cycle in arm.cycles():
            arm.set_positions([start + 0.1 * cycle.time])
            if cycle.number % 10 == 0:
                yield arm.positions


def test_an_async_generator_that_is_closed() -> None:
    async def test() -> None:
        async with simulated(3) as host:
            async with aclosing(positions()) as found:
                async for _ in found:
                    if position_of(host, drives(host)[0]) > 1000:
                        break
            await check(host)

    run(test)


def test_an_async_generator_that_is_closed_by_another_task() -> None:
    async def test() -> None:
        async with simulated(3) as host:
            found = positions()
            await anext(found)
            await anext(found)
            await asyncio.create_task(found.aclose())  # type: ignore[attr-defined]
            await check(host)

    run(test)


def test_an_async_generator_that_is_forgotten_when_the_program_ends(caplog: pytest.LogCaptureFixture) -> None:
    """asyncio.run cancels all tasks, waits for them, and only then closes generators."""
    kept: list[AsyncIterator[list[float]]] = []
    host: list[Host] = []

    async def serve(task_status: TaskStatus[Host]) -> None:
        with loop.move_on_after(10, shield=True):  # real drives are not cancelled
            await simulate(await open_transport(BUS), powerballs(3), task_status=task_status)

    async def main() -> None:
        host.append(await loop.open_nursery().start(serve))  # type: ignore[attr-defined]
        kept.append(positions())
        await anext(kept[0])
        await anext(kept[0])

    with asyncio.Runner(loop_factory=lambda: WorldLoop(loops.VirtualTime())) as runner:
        runner.run(main())
    assert_all_halted(host[0])
    assert "its drives are halted now" in caplog.text


# ---- Ctrl-C ----


@pytest.mark.thorough(5)
@pytest.mark.parametrize("times", [1, 2, 3])
@pytest.mark.parametrize("seconds", TIMES)
def test_ctrl_c_in_the_middle_of_a_turn_waits_for_its_end(monkeypatch: pytest.MonkeyPatch, seconds: float, times: int) -> None:
    """A second one would be raised where it comes: between a machine that has sent, and the wire."""
    hosts: list[Host] = []
    left = [times]
    halves: list[bool] = []
    drain = Network.drain

    def press_and_drain(network: Network, now: int) -> Any:
        halves.append(True)
        if left[0] and now >= seconds * 1e9 and network is masters[0]:
            left[0] -= 1
            signal.raise_signal(signal.SIGINT)
        halves.pop()
        return drain(network, now)

    masters: list[Network] = []
    monkeypatch.setattr(Network, "drain", press_and_drain)

    async def test() -> None:
        async with simulated(3, 4) as host:
            hosts.append(host)
            try:
                async with open_master(BUS) as master:
                    masters.append(master.bus().network)
                    await home(arm_of(master, 3, 4))
            finally:
                with loop.cancel_scope(shield=True):
                    await check(host)

    with pytest.raises(KeyboardInterrupt):
        run(test)
    assert left == [0]
    assert halves == []
    assert_all_halted(hosts[0])


def test_the_handler_of_ctrl_c_is_given_back() -> None:
    async def test() -> None:
        before = signal.getsignal(signal.SIGINT)
        async with open_master(BUS), open_master("virtual:other"):
            assert signal.getsignal(signal.SIGINT) != before
        assert signal.getsignal(signal.SIGINT) == before

    run(test)


# ---- foreign transports, and all tasks cancelled ----


class Queued:
    """A transport in plain asyncio, that knows nothing of scopes and shields."""

    def __init__(self) -> None:
        self._inner = VirtualTransport("test")
        self._frames: asyncio.Queue[Received] = asyncio.Queue()
        self._task = asyncio.create_task(self._pass_on())

    async def _pass_on(self) -> None:
        while True:
            with suppress(asyncio.CancelledError):  # as far as this test goes, it is the adapter
                item = await self._inner.receive()
                assert isinstance(item, tuple)
                self._frames.put_nowait(item)
            if self._inner._closed:
                return

    async def send(self, frame: Frame) -> None:
        await asyncio.sleep(0.0001)
        self._inner.send_nowait(frame)

    async def receive(self) -> Received:
        return await self._frames.get()

    async def aclose(self) -> None:
        await self._inner.aclose()
        self._task.cancel()


def test_all_tasks_are_cancelled_at_once_as_at_the_end_of_asyncio_run() -> None:
    async def test() -> None:
        async with simulated(3, 4) as host:

            async def work() -> None:
                async with open_master(Queued()) as master:
                    await home(arm_of(master, 3, 4))

            task = asyncio.create_task(work())
            await asyncio.sleep(0.7)
            for _ in range(3):
                for each in asyncio.all_tasks() - {asyncio.current_task()}:
                    each.cancel()
                await asyncio.sleep(0.0005)
            with pytest.raises(asyncio.CancelledError):
                await task
            await check(host)

    run(test)


# ---- what it needs ----


def test_the_loop_of_another_thread_is_refused_and_disturbs_nothing() -> None:
    async def test() -> None:
        async with simulated(3), open_master(BUS) as master:
            node = master.node(3)
            for ask in (lambda: node.read("device_type"), lambda: master.run(read(node.remote, "device_type"))):

                def elsewhere(ask: Callable[[], Any] = ask) -> None:
                    with pytest.raises(LocalProtocolError, match="another event loop, or thread"):
                        asyncio.run(ask())

                await asyncio.to_thread(elsewhere)
            assert await node.read("device_type") == 0x20192

    run(test)


def test_a_command_from_another_thread_is_refused_and_changes_nothing() -> None:
    async def test() -> None:
        async with simulated(3), open_master(BUS) as master:
            node = master.node(3)
            commands: list[Callable[[], object]] = [
                lambda: node.start_guarding(0.1),
                node.stop_guarding,
                lambda: node.supervise_heartbeat(0.1),
                lambda: node.enable_rpdo(1),
                lambda: node.send_mpdo(1, "controlword", 15),
                lambda: master.sync_start(0.01),
                master.sync_stop,
            ]

            def elsewhere() -> None:
                for command in commands:
                    with pytest.raises(LocalProtocolError, match="another event loop, or thread"):
                        command()

            await asyncio.to_thread(elsewhere)
            assert (node.remote.guarding.guard_time, node.remote.heartbeat.timeout, master.sync_period) == (0, 0, 0)
            assert not node.was_enabled

    run(test)


def test_neither_trio_nor_a_thread_is_needed() -> None:
    script = """
import asyncio, sys, threading
from canopen_master import open_master, powerballs, simulate
from canopen_transports import open_transport
from canopen_transports.loop import current_loop

async def main():
    async with current_loop().open_nursery() as nursery:
        await nursery.start(simulate, await open_transport("virtual:demo"), powerballs(3))
        async with open_master("virtual:demo") as master:
            print(await master.node(3).read("device_type"), "trio" in sys.modules, threading.active_count())
        nursery.cancel_scope.cancel()

asyncio.run(main())
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=100, check=True)
    assert done.stdout == "131474 False 1\n"


def test_a_machine_that_is_commanded_by_itself_is_taken_up_before_the_loop_sleeps() -> None:
    async def test() -> None:
        async with simulated(3), open_master(BUS) as master, await open_transport(BUS) as spy:
            node = master.node(3)
            node.remote.start_guarding(100_000_000, 3, master.now())
            frame, _ = await spy.receive()
            assert str(frame) == "703#R1"
            assert loop.current_time() == 0

    run(test)
