"""`SleepWatch`: how long the computer slept.

On Linux the clock of the loop, CLOCK_MONOTONIC, stands still meanwhile: a laptop that is opened again would move its joints on as
if it had never been closed. On Windows, and where a virtual machine was held, that clock goes on, and shows the gap itself.
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
        # This one first: time that passes until the other is read counts now, not at the next call
        standing_still = self._standing_still()
        return self._going_on() - standing_still


def sleep_watch() -> SleepWatch | None:
    """Return a watch over this computer; None where there is none, or where the time of the present loop is not the real one."""
    if sys.platform != "linux" or not current_loop().is_real_time():
        return None
    return SleepWatch(lambda: time.clock_gettime_ns(time.CLOCK_BOOTTIME), lambda: time.clock_gettime_ns(time.CLOCK_MONOTONIC))
