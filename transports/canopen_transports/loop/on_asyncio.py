"""asyncio as a `Loop`. uvloop is asyncio, too: where it differs, the code says so."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Sized
from contextlib import AbstractContextManager
from typing import Any, Final, TypeVar

from canopen_transports.loop.asyncio_interrupts import AsyncioInterrupts
from canopen_transports.loop.asyncio_left import cancelled_at_exit
from canopen_transports.loop.asyncio_parts import (
    AsyncioEvent,
    AsyncioFiles,
    AsyncioLock,
    AsyncioLot,
    AsyncioSocket,
    AsyncioToken,
    checkpoint,
    connect_tcp,
    in_thread,
)
from canopen_transports.loop.asyncio_scopes import AsyncioNursery, AsyncioScope, AsyncioTasks
from canopen_transports.loop.interface import BusyResourceError, ClosedResourceError, RunFinishedError

T = TypeVar("T")

LOOK: Final = 0.005
"""Seconds between two looks where a loop does not tell when it sleeps: uvloop."""
ROUNDS: Final = 50
"""Rounds of the loop after which all tasks should wait; uvloop does not tell whether they do."""
_REAL: Final = 0.1
"""Seconds by which a loop in real time may differ from the clock: uvloop looks at it once a turn."""

_loops: dict[asyncio.AbstractEventLoop, AsyncioLoop] = {}


def running_loop() -> AsyncioLoop | None:
    """Return the asyncio loop that runs in this thread."""
    try:
        loop = asyncio.get_running_loop()
    except RuntimeError:
        return None
    found = _loops.get(loop)
    if found is None:
        for other in [each for each in _loops if each.is_closed()]:
            _loops.pop(other, None)
        found = _loops[loop] = AsyncioLoop(loop)
    return found


class AsyncioLoop:
    """See `Loop`."""

    name: Final = "asyncio"
    cancels_at_end: Final = True
    rounds_to_hear: Final = 3  # the first sees the file, the second calls who waits for it, the third runs the task
    Cancelled: Final = asyncio.CancelledError
    ClosedResourceError: Final = ClosedResourceError
    BusyResourceError: Final = BusyResourceError
    RunFinishedError: Final = RunFinishedError

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._is_real = abs(loop.time() - time.monotonic()) < _REAL
        # uvloop's own time is that of the present turn, in milliseconds
        self.current_time: Callable[[], float] = time.monotonic if self._is_real else loop.time
        self._tasks = AsyncioTasks(loop, self.current_time)
        self._files = AsyncioFiles(self._tasks)
        self._token = AsyncioToken(loop)
        self._system_tasks: set[asyncio.Task[None]] = set()
        self._looks: list[Callable[[float | None], object]] = []
        self.values: dict[object, Any] = {}
        self._interrupts = AsyncioInterrupts(self._token)

    # ---- time ----

    def clock(self) -> Callable[[], float]:
        return self.current_time

    def is_real_time(self) -> bool:
        return self._is_real

    async def sleep(self, seconds: float, /) -> None:
        if seconds > 0:
            await self.sleep_until(self.current_time() + seconds)
        else:
            await self.checkpoint()

    async def sleep_until(self, deadline: float, /) -> None:
        if self.current_time() >= deadline:
            await self.checkpoint()
        lot = self.parking_lot()
        while (left := deadline - self.current_time()) > 0:  # uvloop wakes up to a millisecond early
            timer = self._loop.call_later(left, lot.unpark_all)
            try:
                await lot.park()
            finally:
                timer.cancel()

    async def sleep_forever(self) -> None:
        lot = self.parking_lot()
        while True:
            await lot.park()

    # ---- cancelling ----

    def cancel_scope(self, *, deadline: float = math.inf, shield: bool = False) -> AsyncioScope:
        return AsyncioScope(self._tasks, deadline, shield)

    def move_on_after(self, seconds: float, *, shield: bool = False) -> AsyncioScope:
        return AsyncioScope(self._tasks, self.current_time() + seconds, shield)

    def move_on_at(self, deadline: float, *, shield: bool = False) -> AsyncioScope:
        return AsyncioScope(self._tasks, deadline, shield)

    async def cancelled_from_outside(self) -> None:
        await self._tasks.check()
        if (task := asyncio.current_task()) is not None:
            cancelled_at_exit(task)
        try:
            await self._loop.create_future()
        except asyncio.CancelledError:
            if not self._tasks.goes_on(has_ended=not self._tasks.is_cancelled()):
                raise

    async def checkpoint(self) -> None:
        await checkpoint(self._tasks)

    async def checkpoint_if_cancelled(self) -> None:
        await self._tasks.check()

    async def cancel_shielded_checkpoint(self) -> None:
        await checkpoint(self._tasks, may_be_cancelled=False)

    async def wait_all_tasks_blocked(self) -> None:
        ready: Sized | None = getattr(self._loop, "_ready", None)
        for number in range(ROUNDS):
            await self.checkpoint()
            if ready is not None and not ready and number >= self.rounds_to_hear:
                return

    # ---- tasks ----

    def open_nursery(self) -> AsyncioNursery:
        return AsyncioNursery(self._tasks)

    def spawn_system_task(self, function: Callable[..., Awaitable[object]], /, *args: Any, name: str) -> object:
        async def run() -> None:
            await function(*args)

        task = self._loop.create_task(run(), name=name)
        self._system_tasks.add(task)  # asyncio holds its tasks weakly
        task.add_done_callback(self._on_system_task_end)
        return task

    def _on_system_task_end(self, task: asyncio.Task[None]) -> None:
        self._system_tasks.discard(task)
        if not task.cancelled() and isinstance(error := task.exception(), Exception):
            raise error  # told by the loop's exception handler

    def parking_lot(self) -> AsyncioLot:
        return AsyncioLot(self._tasks)

    def event(self) -> AsyncioEvent:
        return AsyncioEvent(self._tasks)

    def lock(self) -> AsyncioLock:
        return AsyncioLock(self._tasks)

    # ---- threads ----

    def token(self) -> AsyncioToken:
        return self._token

    async def in_thread(self, function: Callable[..., T], /, *args: Any, abandon_on_cancel: bool = False) -> T:
        return await in_thread(self._tasks, self._token, function, args, abandon_on_cancel)

    def before_sleep(self, look: Callable[[float | None], object]) -> Callable[[], None]:
        self._looks.append(look)
        if len(self._looks) == 1:
            self._begin_looking()
        return lambda: self._looks.remove(look)

    def _begin_looking(self) -> None:
        selector = getattr(self._loop, "_selector", None)
        if selector is None:
            self._look_again()
        elif not isinstance(selector, _LookingSelector):
            self._loop._selector = _LookingSelector(selector, self._looks)  # type: ignore[attr-defined]

    def _look_again(self) -> None:
        for look in tuple(self._looks):
            look(None)
        if self._looks:
            self._loop.call_later(LOOK, self._look_again)

    def holding_interrupts(self) -> AbstractContextManager[object]:
        return self._interrupts.hold()

    def interrupts_wait(self) -> AbstractContextManager[Callable[[], bool]]:
        return self._interrupts.wait()

    # ---- files and sockets ----

    async def wait_readable(self, file: Any, /) -> None:
        await self._files.wait(file, False)

    async def wait_writable(self, file: Any, /) -> None:
        await self._files.wait(file, True)

    def notify_closing(self, file: Any, /) -> None:
        self._files.notify_closing(file)

    async def connect_tcp(self, host: str, port: int) -> AsyncioSocket:
        return await connect_tcp(self._tasks, self._token, self._files, host, port)


class _LookingSelector:
    """The selector of a loop, whose `select` looks first. asyncio has no other way to tell that it will sleep."""

    def __init__(self, selector: Any, looks: list[Callable[[float | None], object]]) -> None:
        self._selector = selector
        self._looks = looks

    def __getattr__(self, name: str) -> Any:
        return getattr(self._selector, name)

    def select(self, timeout: float | None = None) -> Any:
        if timeout is None or timeout > 0:
            for look in self._looks:
                look(timeout)
        return self._selector.select(timeout)
