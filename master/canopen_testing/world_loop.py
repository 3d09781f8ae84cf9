"""`WorldLoop`: an asyncio loop whose time is that of a world.

Loops with virtual time that are on PyPI (looptime, async-solipsism, aiotools) jump to the next timer of the loop. Here a frame
may come before that, and time must stop there: the loop asks the world how far it may go.

Ready callbacks run first, in asyncio's order, which is fixed. When none is ready, the world goes to its next happening or to the
loop's next timer. Real files are looked at without waiting for them. While a thread of an executor works, time stands still.
"""

from __future__ import annotations

import asyncio
import math
import selectors
from collections.abc import Mapping
from functools import partial
from typing import Any, Protocol

from canopen_proto.machine import NEVER, SECOND, Time
from canopen_testing.working_threads import WorkingThreads


class Passing(Protocol):
    """The part of a ProgramWorld that a loop needs."""

    now: Time

    def pass_time(self, end: Time, threads: WorkingThreads) -> float:
        """See ProgramWorld."""


class WorldLoop(asyncio.SelectorEventLoop):
    """See this module's text. Make one for each program: `asyncio.Runner(loop_factory=lambda: WorldLoop(world))`."""

    def __init__(self, world: Passing) -> None:
        self._threads = WorkingThreads()
        self._abandoned: list[str] = []  # threads that may still work, though nobody awaits them
        super().__init__(_WorldSelector(world, self._threads))
        self.world = world

    def time(self) -> float:
        """Return the world's time in seconds."""
        return self.world.now / SECOND

    @property
    def _clock_resolution(self) -> float:
        """By so much asyncio lets a timer come early: 1 ns by itself. That is the world's unit. Who looks at the clock then, and
        sets the timer once more, would do so for ever: no time passes between."""
        return max(0.5 / SECOND, math.ulp(self.time()))

    @_clock_resolution.setter
    def _clock_resolution(self, resolution: float) -> None:
        """asyncio's constructor sets that of its own clock."""

    def run_in_executor(self, executor: Any, func: Any, *args: Any) -> asyncio.Future[Any]:  # type: ignore[override]
        """See asyncio."""
        inner = func.args[0] if isinstance(func, partial) and func.args else func  # asyncio.to_thread calls it in a context
        name = getattr(inner, "__qualname__", repr(inner))
        ends = self._threads.begins(name)
        try:
            future = super().run_in_executor(executor, func, *args)
        except BaseException:
            ends()
            raise

        def done(future: asyncio.Future[Any]) -> None:
            ends()
            if future.cancelled():
                self._abandoned.append(name)

        future.add_done_callback(done)
        return future

    async def shutdown_default_executor(self, *args: Any) -> None:
        """See asyncio, which starts a thread for it."""
        ends = self._threads.begins(", ".join(self._abandoned) or "the executor")
        try:
            await super().shutdown_default_executor(*args)
        finally:
            ends()


class _WorldSelector(selectors.BaseSelector):
    """Looks at real files, but waits in the world's time."""

    def __init__(self, world: Passing, threads: WorkingThreads) -> None:
        self._world = world
        self._threads = threads
        self._real = selectors.DefaultSelector()

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._real.register(fileobj, events, data)

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        return self._real.unregister(fileobj)

    def modify(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._real.modify(fileobj, events, data)

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = self._real.select(0)
        if ready or (timeout is not None and timeout <= 0):
            return ready
        now = self._world.now
        end = NEVER if timeout is None else max(math.ceil(now + timeout * SECOND), now + 1)
        return self._real.select(self._world.pass_time(end, self._threads))

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        return self._real.get_map()

    def close(self) -> None:
        self._real.close()
