"""Alarms, by which the timekeeper sleeps until a deadline.

trio and asyncio hand their deadlines to epoll, which counts in milliseconds and rounds up: a wake is 0.6 ms late in the median.
That is too much for a SYNC of 1 to 4 ms. Linux has timers that are files (timerfd). They are exact to a microsecond, and a loop
can wait for one as for any other file. So a real clock on Linux gets `FineAlarm`. Other systems, tests in virtual time, and a
`PatientClock`, which has to know all deadlines, get `CoarseAlarm`.
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
from contextlib import suppress
from typing import Final, TypeAlias

from canopen_transports.loop import CancelScope, current_loop

_CLOCK_MONOTONIC: Final = 1
_NANOSECONDS: Final = 1_000_000_000


class CoarseAlarm:
    """Wakes at the loop's own deadlines."""

    def __init__(self) -> None:
        self._loop = current_loop()
        self._deadline = math.inf
        self._scope: CancelScope | None = None

    def set(self, deadline: float) -> None:
        """Wake at this time (seconds of the loop's clock), or earlier if an earlier one is set: an early wake does no harm."""
        if deadline < self._deadline:
            self._deadline = deadline
            if self._scope is not None:
                self._scope.deadline = deadline

    async def wait(self) -> None:
        """Sleep until the time that `set` gave, before this call or during it. Afterwards no time is set."""
        with self._loop.cancel_scope(deadline=self._deadline) as self._scope:
            await self._loop.sleep_forever()
        self._scope = None
        self._deadline = math.inf

    def close(self) -> None:
        """Do nothing: this alarm holds no file."""


class _Interval(ctypes.Structure):
    _fields_ = [("every", ctypes.c_long * 2), ("first", ctypes.c_long * 2)]  # each in seconds and nanoseconds


class FineAlarm:
    """Wakes by a timerfd; used as `CoarseAlarm` is. Raises OSError or AttributeError if the system has none."""

    def __init__(self) -> None:
        self._loop = current_loop()
        self._deadline = math.inf
        libc = ctypes.CDLL(None, use_errno=True)
        self._set_time = libc.timerfd_settime
        self._fd: int = libc.timerfd_create(_CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        if self._fd < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create failed")
        self._interval = _Interval()
        self._reference = ctypes.byref(self._interval)

    def set(self, deadline: float) -> None:
        """Wake at this time; see `CoarseAlarm`."""
        if deadline >= self._deadline:
            return
        self._deadline = deadline
        left = max(1, round((deadline - self._loop.current_time()) * _NANOSECONDS))  # 0 would mean never
        self._interval.first[:] = divmod(left, _NANOSECONDS)
        self._set_time(self._fd, 0, self._reference, None)

    async def wait(self) -> None:
        """Sleep until the time that `set` gave; see `CoarseAlarm`."""
        await self._loop.wait_readable(self._fd)
        with suppress(BlockingIOError):  # it was set again just now
            os.read(self._fd, 8)
        self._deadline = math.inf

    def close(self) -> None:
        """Close the timer's file."""
        os.close(self._fd)


Alarm: TypeAlias = CoarseAlarm | FineAlarm


def best_alarm() -> Alarm:
    """Return the best alarm that this platform has for the clock of the present loop."""
    if sys.platform == "linux" and current_loop().is_real_time():
        with suppress(OSError, AttributeError):
            return FineAlarm()
    return CoarseAlarm()
