"""`Loop`: what a part of this project asks of the event loop that runs it, in trio's words.

Times are in seconds of the loop's clock. Everything but `LoopToken` is for the thread of the loop.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager, AbstractContextManager
from types import TracebackType
from typing import Any, Final, Generic, Protocol, Self, TypeVar

T = TypeVar("T")
T_contra = TypeVar("T_contra", contravariant=True)


class ClosedResourceError(Exception):
    """Our own side has closed what is used; on trio it is trio.ClosedResourceError. See `Loop.ClosedResourceError`."""


class BusyResourceError(Exception):
    """Two tasks wait for one file; on trio it is trio.BusyResourceError. See `Loop.BusyResourceError`."""


class RunFinishedError(RuntimeError):
    """The loop has ended, and runs nothing more; on trio it is trio.RunFinishedError. See `Loop.RunFinishedError`."""


class CancelScope(Protocol):
    """Cancels what is awaited in its block, when it is told to or its deadline comes; as trio.CancelScope."""

    deadline: float
    """When it cancels by itself, in seconds of the loop's clock; math.inf: never."""
    shield: bool
    """Whether scopes around it, and on asyncio a `Task.cancel`, do not reach into its block."""

    @property
    def cancel_called(self) -> bool:
        """Whether it was cancelled."""

    @property
    def cancelled_caught(self) -> bool:
        """Whether its block was left because of that."""

    def cancel(self) -> None:
        """Cancel each await in the block, from now on."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool | None: ...


class ParkingLot(Protocol):
    """Tasks that wait until they are woken, in order; as trio.lowlevel.ParkingLot."""

    def __bool__(self) -> bool:
        """Whether a task waits."""

    async def park(self) -> None:
        """Wait until woken."""

    def unpark(self) -> object:
        """Wake the task that waits longest."""

    def unpark_all(self) -> object:
        """Wake all tasks that wait."""


class OneTimeEvent(Protocol):
    """Something that happens once; as trio.Event."""

    def is_set(self) -> bool:
        """Whether it has happened."""

    def set(self) -> None:
        """Let it have happened, and wake those who wait."""

    async def wait(self) -> None:
        """Wait until it has happened."""


class FairLock(Protocol):
    """A lock that tasks get in the order in which they ask; as trio.StrictFIFOLock."""

    def locked(self) -> bool:
        """Whether a task has it."""

    async def __aenter__(self) -> None: ...

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None: ...


class TaskStatus(Protocol[T_contra]):
    """By which a task that `Nursery.start` has begun says that it is ready; as trio.TaskStatus."""

    def started(self, value: T_contra = ...) -> None:
        """Let `Nursery.start` return this value."""


class _Ignored(Generic[T]):
    def started(self, value: T | None = None) -> None:
        """Do nothing: nobody waits for the value."""


TASK_STATUS_IGNORED: Final[Any] = _Ignored()
"""For a task that nobody waits for."""


class Nursery(Protocol):
    """Tasks that end before its block does; as trio.Nursery. A task that fails cancels the others."""

    @property
    def cancel_scope(self) -> CancelScope:
        """Around all its tasks and its block."""

    def start_soon(self, function: Callable[..., Awaitable[object]], /, *args: Any) -> None:
        """Run a task."""

    async def start(self, function: Callable[..., Awaitable[object]], /, *args: Any) -> Any:
        """Run a task, which gets `task_status`; wait until it says that it is ready, and return what it says."""


class LoopToken(Protocol):
    """The way into the loop from other threads; as trio.lowlevel.TrioToken."""

    def run_sync_soon(self, function: Callable[..., object], /, *args: Any, idempotent: bool = False) -> None:
        """Let the loop call a function. idempotent: once only, if it is asked again before it has. Raises
        Loop.RunFinishedError."""


class StreamSocket(Protocol):
    """A TCP connection; as trio.socket.SocketType."""

    def send(self, data: bytes, /) -> Awaitable[int]:
        """Wait until some bytes fit; return how many were sent. If cancelled, none were."""

    def recv(self, size: int, /) -> Awaitable[bytes]:
        """Wait for bytes; return `size` at most, none at the end."""

    def setsockopt(self, level: int, option: int, value: int, /) -> None: ...

    def close(self) -> None:
        """Close it. Tasks that wait get Loop.ClosedResourceError."""


class AsyncResource(ABC):
    """Something that is closed: `async with` closes it. On trio it counts as a trio.abc.AsyncResource."""

    @abstractmethod
    async def aclose(self) -> None:
        """Close it, also if cancelled meanwhile."""

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        await self.aclose()


class Loop(Protocol):
    """An event loop that runs. Get it by `current_loop()`. name: "trio" or "asyncio".

    cancels_at_end: whether it cancels all tasks when its main one has ended, as asyncio.run does; trio waits for them.
    rounds_to_hear: after so many `checkpoint`s, a task that waits for a file that was readable before has run.
    """

    @property
    def name(self) -> str: ...

    @property
    def cancels_at_end(self) -> bool: ...

    @property
    def rounds_to_hear(self) -> int: ...

    @property
    def values(self) -> dict[object, Any]:
        """What belongs to this run of the loop, by its `RunVar`."""

    @property
    def Cancelled(self) -> type[BaseException]:
        """What ends an await that is cancelled: trio.Cancelled, asyncio.CancelledError."""

    @property
    def ClosedResourceError(self) -> type[Exception]:
        """Our own side has closed what is used."""

    @property
    def BusyResourceError(self) -> type[Exception]:
        """Two tasks wait for one file."""

    @property
    def RunFinishedError(self) -> type[Exception]:
        """The loop has ended, and runs nothing more."""

    # ---- time ----

    def clock(self) -> Callable[[], float]:
        """Return the function that tells the time in seconds: the quickest way to ask often."""

    def current_time(self) -> float:
        """Return the time in seconds."""

    def is_real_time(self) -> bool:
        """Whether its time passes as that of the world does, and as CLOCK_MONOTONIC."""

    async def sleep(self, seconds: float, /) -> None:
        """Wait for so long."""

    async def sleep_until(self, deadline: float, /) -> None:
        """Wait until this time."""

    async def sleep_forever(self) -> None:
        """Wait until cancelled."""

    # ---- cancelling ----

    def cancel_scope(self, *, deadline: float = math.inf, shield: bool = False) -> CancelScope:
        """Return a scope, for `with`."""

    def move_on_after(self, seconds: float, *, shield: bool = False) -> CancelScope:
        """Return a scope that cancels itself after so many seconds."""

    def move_on_at(self, deadline: float, *, shield: bool = False) -> CancelScope:
        """Return a scope that cancels itself at this time."""

    async def cancelled_from_outside(self) -> None:
        """Return when the loop's own means cancel this task, whatever shields it: where `cancels_at_end`. Python's end cancels it
        too, if the loop is left then, and waits some seconds until the task is done."""

    async def checkpoint(self) -> None:
        """Let other tasks run; may be cancelled."""

    async def checkpoint_if_cancelled(self) -> None:
        """Do nothing, unless cancelled."""

    async def cancel_shielded_checkpoint(self) -> None:
        """Let other tasks run; cannot be cancelled."""

    async def wait_all_tasks_blocked(self) -> None:
        """Let other tasks run until all wait. For tests."""

    # ---- tasks ----

    def open_nursery(self) -> AbstractAsyncContextManager[Nursery]:
        """Return a nursery, for `async with`."""

    def spawn_system_task(self, function: Callable[..., Awaitable[object]], /, *args: Any, name: str) -> object:
        """Run a task that ends with the loop."""

    def parking_lot(self) -> ParkingLot: ...

    def event(self) -> OneTimeEvent: ...

    def lock(self) -> FairLock: ...

    # ---- threads ----

    def token(self) -> LoopToken:
        """Return the way in for other threads."""

    async def in_thread(self, function: Callable[..., T], /, *args: Any, abandon_on_cancel: bool = False) -> T:
        """Call a function in a thread, and return its result. abandon_on_cancel: if cancelled, leave the thread behind; else wait
        for its end."""

    def before_sleep(self, look: Callable[[float | None], object]) -> Callable[[], None]:
        """Call `look` each time before the loop sleeps; return the function that ends this. `look` must not raise."""

    def holding_interrupts(self) -> AbstractContextManager[object]:
        """While it lasts, a Ctrl-C does not interrupt `protected` functions in their middle."""

    def interrupts_wait(self) -> AbstractContextManager[Callable[[], bool]]:
        """While it lasts, a Ctrl-C waits for its end; the function that it gives tells whether one has come. On trio it does not
        wait: it comes to the main task alone."""

    # ---- files and sockets ----

    async def wait_readable(self, file: Any, /) -> None:
        """Wait until a file (a descriptor, or what has `fileno`) can be read."""

    async def wait_writable(self, file: Any, /) -> None:
        """Wait until a file can be written."""

    def notify_closing(self, file: Any, /) -> None:
        """Wake those who wait for a file with ClosedResourceError. Call it before the file is closed."""

    async def connect_tcp(self, host: str, port: int) -> StreamSocket:
        """Connect to a server. Raises OSError, UnicodeError."""
