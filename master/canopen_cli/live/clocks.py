"""The times of frames as what follows them needs them: they never go back. `FrameClock`: of what is live, and so goes on between
frames.
"""

from __future__ import annotations

import trio

from canopen_proto.machine import SECOND, Time
from canopen_transports.record import RecordClock


def trio_now() -> Time:
    """Return the present on trio's clock, ns."""
    return round(trio.current_time() * SECOND)


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
