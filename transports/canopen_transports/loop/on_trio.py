"""trio as a `Loop`: each part is trio's own object, but the parking lot, on which each event and answer passes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Final, TypeVar

import trio
from trio.lowlevel import Abort, Task, current_task, reschedule, wait_task_rescheduled

from canopen_transports.loop.interface import AsyncResource, StreamSocket
from canopen_transports.loop.protection import protected, tell_trio

T = TypeVar("T")

_values: trio.lowlevel.RunVar[dict[object, Any]] = trio.lowlevel.RunVar("canopen_transports")

tell_trio(trio.lowlevel.enable_ki_protection)
trio.abc.AsyncResource.register(AsyncResource)  # type: ignore[type-abstract]


class TrioLot:
    """See `ParkingLot`: trio's own without what nobody uses here, in half the time."""

    __slots__ = ("_parked",)

    def __init__(self) -> None:
        self._parked: dict[Task, None] = {}  # in order

    def __bool__(self) -> bool:
        return bool(self._parked)

    @protected
    async def park(self) -> None:
        parked, task = self._parked, current_task()

        def abort(_: object) -> Abort:
            del parked[task]
            return Abort.SUCCEEDED

        parked[task] = None
        await wait_task_rescheduled(abort)

    @protected
    def unpark(self) -> None:
        for task in self._parked:
            del self._parked[task]
            reschedule(task)
            break

    @protected
    def unpark_all(self) -> None:
        for task in self._parked:
            reschedule(task)
        self._parked.clear()


class TrioLoop:
    """See `Loop`."""

    name: Final = "trio"
    cancels_at_end: Final = False
    rounds_to_hear: Final = 2  # through a thread, the second one is needed
    Cancelled: Final = trio.Cancelled
    ClosedResourceError: Final = trio.ClosedResourceError
    BusyResourceError: Final = trio.BusyResourceError
    RunFinishedError: Final = trio.RunFinishedError

    current_time = staticmethod(trio.current_time)
    sleep = staticmethod(trio.sleep)
    sleep_until = staticmethod(trio.sleep_until)
    sleep_forever = staticmethod(trio.sleep_forever)
    cancel_scope = staticmethod(trio.CancelScope)
    move_on_after = staticmethod(trio.move_on_after)
    move_on_at = staticmethod(trio.move_on_at)
    checkpoint = staticmethod(trio.lowlevel.checkpoint)
    checkpoint_if_cancelled = staticmethod(trio.lowlevel.checkpoint_if_cancelled)
    cancel_shielded_checkpoint = staticmethod(trio.lowlevel.cancel_shielded_checkpoint)
    open_nursery = staticmethod(trio.open_nursery)
    spawn_system_task = staticmethod(trio.lowlevel.spawn_system_task)
    parking_lot = TrioLot
    event = staticmethod(trio.Event)
    lock = staticmethod(trio.StrictFIFOLock)
    token = staticmethod(trio.lowlevel.current_trio_token)
    wait_readable = staticmethod(trio.lowlevel.wait_readable)
    wait_writable = staticmethod(trio.lowlevel.wait_writable)
    notify_closing = staticmethod(trio.lowlevel.notify_closing)

    @property
    def values(self) -> dict[object, Any]:
        try:
            return _values.get()
        except LookupError:
            _values.set({})
            return _values.get()

    async def wait_all_tasks_blocked(self) -> None:
        import trio.testing  # only here: it takes longer to import than all of this package

        await trio.testing.wait_all_tasks_blocked()

    async def cancelled_from_outside(self) -> None:
        await trio.sleep_forever()

    def clock(self) -> Callable[[], float]:
        return trio.lowlevel.current_clock().current_time

    def is_real_time(self) -> bool:
        clock = trio.lowlevel.current_clock()
        if getattr(clock, "has_to_know_deadlines", False):  # it would see the question below as one
            return False
        return abs(clock.deadline_to_sleep_time(clock.current_time() + 1.0) - 1.0) < 0.1

    async def in_thread(self, function: Callable[..., T], /, *args: Any, abandon_on_cancel: bool = False) -> T:
        # A limiter for each call: drivers that hang would use up trio's 40 threads, which files and names need, too.
        limiter = trio.CapacityLimiter(1)
        return await trio.to_thread.run_sync(function, *args, abandon_on_cancel=abandon_on_cancel, limiter=limiter)

    def before_sleep(self, look: Callable[[float | None], object]) -> Callable[[], None]:
        instrument = _BeforeSleep(look)
        trio.lowlevel.add_instrument(instrument)
        return lambda: trio.lowlevel.remove_instrument(instrument)

    def holding_interrupts(self) -> AbstractContextManager[object]:
        return nullcontext()  # trio does it by itself

    def interrupts_wait(self) -> AbstractContextManager[Callable[[], bool]]:
        return nullcontext(lambda: False)

    async def connect_tcp(self, host: str, port: int) -> StreamSocket:
        return (await trio.open_tcp_stream(host, port)).socket


class _BeforeSleep(trio.abc.Instrument):
    def __init__(self, look: Callable[[float], object]) -> None:
        self.before_io_wait = look  # type: ignore[assignment, method-assign] # one call less in each round of the scheduler
