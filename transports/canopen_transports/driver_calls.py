"""Calls into drivers, each in a thread: they take their time, and some never come back.

Nobody can stop a thread. So a driver gets DRIVER_TIME, then its thread is left behind: a command that was interrupted comes to
its end all the same, and the adapter is reported as lost.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Final, TypeVarTuple

import can
import trio

from canopen_transports.leftovers import shut_down

DRIVER_TIME: Final = 2.0
"""Seconds that a driver has to come back. Those that wait on their own do so for about 1 s (libusb, a serial line's limit)."""

Ts = TypeVarTuple("Ts")


async def call(function: Callable[[], None]) -> None:
    """Run `function` in a thread, to its end, even if cancelled: what it does to the bus is done or not, but not half.

    TimeoutError when it has not come back in DRIVER_TIME.
    """
    with trio.move_on_after(DRIVER_TIME, shield=True) as scope:
        await _in_thread(function)
    if scope.cancelled_caught:
        raise TimeoutError(f"the driver has not come back for {DRIVER_TIME:g} s")


async def open_bus(opening: Callable[[], can.BusABC]) -> can.BusABC:
    """Run `opening` in a thread, for as long as the driver takes (python-can's slcan sleeps 2 s).

    Cancelled, we wait DRIVER_TIME for it, so that the adapter is free when we come back. What a driver opens even later, its
    thread shuts down again: no adapter stays open behind our back.
    """
    opened: list[can.BusABC] = []
    lock = threading.Lock()
    is_wanted = True
    finished = trio.Event()
    token = trio.lowlevel.current_trio_token()

    def work() -> None:
        try:
            bus = opening()
            with lock:
                opened.append(bus)
                to_keep = is_wanted
            if not to_keep:
                shut_down(bus)
        finally:
            with suppress(trio.RunFinishedError):  # it took so long that the run is over
                token.run_sync_soon(finished.set)

    try:
        await _in_thread(work)
    except BaseException:  # above all a cancel, and Ctrl-C
        with lock:
            is_wanted = False
            too_late = list(opened)  # it came while we were cancelled
        with trio.move_on_after(DRIVER_TIME, shield=True):
            for bus in too_late:
                await _in_thread(shut_down, bus)
            await finished.wait()
        raise
    return opened[0]


async def _in_thread(function: Callable[[*Ts], None], *args: *Ts) -> None:
    # Not one of trio's 40: a driver that hangs each time would take them all, and with them the files and names of the program.
    await trio.to_thread.run_sync(function, *args, abandon_on_cancel=True, limiter=trio.CapacityLimiter(1))
