"""`SleepWatch`: how long the computer slept, which the clock of the loop does not tell on Linux: CLOCK_MONOTONIC stands still
meanwhile, and a laptop that is opened again would move its joints on as if it had never been closed.

On Windows, and where a virtual machine was held, the clock of the loop goes on: what is late then is late by it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from canopen_proto.machine import Time
from canopen_transports.loop import current_loop


class SleepWatch:
    """Compares two clocks of the computer, of which one stands still while it sleeps."""

    def __init__(self, going_on: Callable[[], Time], standing_still: Callable[[], Time]) -> None:
        """going_on: the time, ns, which passes while the computer sleeps too. standing_still: that which does not."""
        self._going_on, self._standing_still = going_on, standing_still
        self._before = self._apart()

    def slept(self) -> Time:
        """Return for how long the computer has slept since the last call, ns."""
        before, self._before = self._before, self._apart()
        return max(0, self._before - before)

    def _apart(self) -> Time:
        standing_still = (
            self._standing_still()
        )  # first: time that passes until the other is read counts now, not at the next call
        return self._going_on() - standing_still


def sleep_watch() -> SleepWatch | None:
    """Return a watch over this computer; None where there is none, or where the time of the present loop is not the real one."""
    if sys.platform != "linux" or not current_loop().is_real_time():
        return None
    return SleepWatch(lambda: time.clock_gettime_ns(time.CLOCK_BOOTTIME), lambda: time.clock_gettime_ns(time.CLOCK_MONOTONIC))
