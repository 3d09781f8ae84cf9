"""Calls into drivers, each in a thread: drivers take their time, and some never return.

A thread cannot be stopped. So a driver gets DRIVER_TIME, and then its thread is left behind: an interrupted command still ends,
and the adapter is reported as lost.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Final, TypeVarTuple

from canopen_transports.leftovers import shut_down
from canopen_transports.loop import current_loop

if TYPE_CHECKING:
    import can

DRIVER_TIME: Final = 2.0
"""Seconds that a driver may take to return. Drivers that wait on their own do so for about 1 s (libusb, a serial line's limit).
"""

Ts = TypeVarTuple("Ts")


async def call(function: Callable[[], None]) -> None:
    """Run `function` in a thread, to its end, even if cancelled, so that its work on the bus is never half done.

    Raises TimeoutError if it has not returned within DRIVER_TIME.
    """
    with current_loop().move_on_after(DRIVER_TIME, shield=True) as scope:
        await _in_thread(function)
    if scope.cancelled_caught:
        raise TimeoutError(f"the driver has not returned for {DRIVER_TIME:g} s")


async def open_bus(opening: Callable[[], can.BusABC]) -> can.BusABC:
    """Run `opening` in a thread for as long as the driver takes (python-can's slcan sleeps 2 s), and return the bus.

    If cancelled, wait DRIVER_TIME for the driver, so that the adapter is free afterwards. If the driver opens the bus even later,
    its thread shuts it down: no adapter stays open unnoticed.
    """
    opened: list[can.BusABC] = []
    lock = threading.Lock()
    is_wanted = True
    loop = current_loop()
    finished, token = loop.event(), loop.token()

    def work() -> None:
        try:
            bus = opening()
            with lock:
                opened.append(bus)
                to_keep = is_wanted
            if not to_keep:
                shut_down(bus)
        finally:
            with suppress(loop.RunFinishedError):  # the run ended before the driver returned
                token.run_sync_soon(finished.set)

    try:
        await _in_thread(work)
    except BaseException:  # above all a cancel, and Ctrl-C
        with lock:
            is_wanted = False
            too_late = list(opened)  # opened while we were cancelled
        with loop.move_on_after(DRIVER_TIME, shield=True):
            for bus in too_late:
                await _in_thread(shut_down, bus)
            await finished.wait()
        raise
    return opened[0]


async def _in_thread(function: Callable[[*Ts], None], *args: *Ts) -> None:
    await current_loop().in_thread(function, *args, abandon_on_cancel=True)
