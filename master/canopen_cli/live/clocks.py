"""The times of frames as what follows them needs them: they never go back. `FrameClock`: of what is live, and so goes on between
frames. `SystemClock`: the time of day, for a recording.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

import trio

from canopen_proto.machine import SECOND, Time
from canopen_transports.record import RecordClock


def trio_now() -> Time:
    """Return the present on trio's clock, ns."""
    return round(trio.current_time() * SECOND)


SET: Final = SECOND
"""The system's clock was set, or the computer slept, if it is further from where it should be. Less is steered, and the times of
frames stay even."""


class SystemClock:
    """How far the system's clock is from trio's, which nobody sets, and which stands still while a computer sleeps. zero: ns from
    trio's clock to the system's."""

    def __init__(self, system: Callable[[], Time] = time.time_ns, own: Callable[[], Time] = trio_now) -> None:
        self._system, self._own = system, own
        self.zero = system() - own()

    def look(self) -> Time:
        """Return `zero`, which is another one if the system's clock was set since the last look."""
        zero = self._system() - self._own()
        if abs(zero - self.zero) > SET:
            self.zero = zero
        return self.zero


class RecordClocks:
    """The clocks of the buses in a recording: each has its own, as two recordings of one hour may stand one behind the other.

    jumps: how often the clock of a bus went back: the most of all.
    """

    def __init__(self) -> None:
        self.jumps = 0
        self._clocks: dict[str, RecordClock] = {}

    def set(self, channel: str, time: Time) -> Time:
        """Take the time of a frame of a bus; see `RecordClock.set`."""
        clock = self._clocks.get(channel)
        if clock is None:
            clock = self._clocks[channel] = RecordClock()
        now = clock.set(time)
        self.jumps = max(self.jumps, clock.jumps)
        return now


class FrameClock(RecordClock):
    """The time of frames as a display needs it: it goes on between two frames, too."""

    def __init__(self) -> None:
        super().__init__()
        self._zero: Time = 0  # from trio's clock to this one

    def set(self, time: Time) -> Time:
        shown = super().set(time)
        self._zero = shown - trio_now()
        return shown

    def now(self) -> Time:
        """Return the present, ns."""
        return trio_now() + self._zero
