"""The event loops on which the master is tested, in virtual time: trio's MockClock, and the asyncio loop of canopen_testing.

A test says `loop.sleep(1)` in place of `trio.sleep(1)`. tests/master/conftest.py chooses: every day trio, and asyncio beside it
for tests that are marked `both_loops`. `pytest --loop=asyncio tests/master` takes all but those marked `trio_only`;
the full check does so.
"""

from __future__ import annotations

import asyncio
import signal
from collections import deque
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar, cast

import trio
import trio.testing

from canopen_proto.machine import NEVER, SECOND, Time
from canopen_testing.working_threads import WorkingThreads
from canopen_testing.world_loop import WorldLoop
from canopen_transports.loop import Loop, current_loop
from canopen_transports.loop.on_asyncio import AsyncioLoop

T = TypeVar("T")
R = TypeVar("R")

TRIO, ASYNCIO = "trio", "asyncio"
DAY = 24 * 3600.0
IN_EARNEST = 0.02
"""Seconds of real time between two looks at threads and files, if nothing else will happen."""


class _Running:
    def __getattr__(self, name: str) -> Any:
        return getattr(current_loop(), name)


loop = cast(Loop, _Running())
"""The loop that runs."""

chosen = TRIO
"""The one for the next test; conftest.py sets it."""


class VirtualTime:
    """Time that jumps to whatever is waited for, as that of trio's MockClock."""

    def __init__(self) -> None:
        self.now: Time = 0

    def pass_time(self, end: Time, threads: WorkingThreads) -> float:
        if threads.take_news():
            return 0.0
        if end >= NEVER or threads.names:
            return IN_EARNEST
        self.now = max(self.now, end)
        return 0.0


def run(test: Callable[[], Awaitable[R]]) -> R:
    """Run a test on the loop that is chosen; it fails after a day of virtual time."""
    return _on_trio(test) if chosen == TRIO else _on_asyncio(test)


def _on_trio(test: Callable[[], Awaitable[R]]) -> R:
    async def limited() -> R:
        with trio.fail_after(DAY):
            return await test()

    return trio.run(limited, clock=trio.testing.MockClock(autojump_threshold=0))


def _on_asyncio(test: Callable[[], Awaitable[R]]) -> R:
    async def limited() -> R:
        async with asyncio.timeout(DAY):
            try:
                return await test()
            finally:
                found = current_loop()
                assert isinstance(found, AsyncioLoop)
                assert not found._tasks._states, "a scope was left open"

    try:
        with asyncio.Runner(loop_factory=lambda: WorldLoop(VirtualTime())) as runner:
            return runner.run(limited())
    finally:
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def is_trio() -> bool:
    return current_loop().name == TRIO


def jump(seconds: float) -> None:
    """The whole process was stalled for so long."""
    if is_trio():
        clock = trio.lowlevel.current_clock()
        assert isinstance(clock, trio.testing.MockClock)
        clock.jump(seconds)
    else:
        running = asyncio.get_running_loop()
        assert isinstance(running, WorldLoop)
        running.world.now += round(seconds * SECOND)


async def settled() -> None:
    """Wait until all other tasks wait, too."""
    await current_loop().wait_all_tasks_blocked()


@contextmanager
def fail_after(seconds: float) -> Iterator[None]:
    with loop.move_on_after(seconds) as scope:
        yield
    assert not scope.cancelled_caught, f"it took longer than {seconds:g} s"


def is_interrupt(error: BaseException) -> bool:
    """Whether it is a Ctrl-C, which trio's nurseries put into groups."""
    if isinstance(error, BaseExceptionGroup):
        return error.subgroup(KeyboardInterrupt) is not None
    return isinstance(error, KeyboardInterrupt)


@contextmanager
def ends_by_interrupt() -> Iterator[None]:
    """The block ends by a Ctrl-C: on trio with a KeyboardInterrupt; asyncio.run cancels the main task, and raises it later."""
    try:
        yield
    except (BaseExceptionGroup, KeyboardInterrupt) as error:
        assert is_trio()
        assert is_interrupt(error)
    except asyncio.CancelledError:
        assert not is_trio()
    else:
        raise AssertionError("no Ctrl-C came out")


class Channel(Generic[T]):
    """A queue between tasks."""

    def __init__(self) -> None:
        self._items: deque[T] = deque()
        self._lot = loop.parking_lot()

    def send(self, item: T) -> None:
        self._items.append(item)
        self._lot.unpark()

    async def receive(self) -> T:
        await loop.checkpoint()
        while not self._items:
            await self._lot.park()
        return self._items.popleft()


def beside(function: Callable[..., Awaitable[object]], *args: object) -> None:
    """Run a function in a task beside all that the test runs."""
    loop.spawn_system_task(function, *args, name="beside")
