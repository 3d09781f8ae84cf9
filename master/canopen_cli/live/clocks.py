"""Clocks of what is live: `StampClock` turns a transport's time stamps into our times, `FrameClock` goes on between frames."""

from __future__ import annotations

from typing import Final

import trio

from canopen_proto.machine import SECOND, Time

_DRIFT: Final = 200e-6
"""The difference of two quartz clocks is smaller: each is within 100 ppm."""
_STALE: Final = 2 * SECOND
"""A frame that seems to have waited for longer did not wait: its clock was set back."""


def trio_now() -> Time:
    """Return the present on trio's clock, ns."""
    return round(trio.current_time() * SECOND)


class StampClock:
    """Turns the time stamps of a transport into times on another clock of ours.

    A frame comes some time after its stamp, never before it. So the shortest such delay is the difference of the two clocks; it
    is allowed to grow slowly, as one of them is faster. zero: is added to each time.
    """

    def __init__(self, zero: Time = 0) -> None:
        self.zero = zero
        self._least: float | None = None
        self._seen: Time = 0
        self._last: Time | None = None

    def time_of(self, stamp: int | None, now: Time) -> Time:
        """Return when a frame came that is handed over now: ns, on the clock of `now` plus `zero`, not before the last frame.

        stamp: of the transport, ns; None if it has none.
        """
        if stamp is None:
            time = now
        else:
            delay = now - stamp
            if self._least is None or delay - self._least > _STALE:
                self._least = delay
            self._least = min(delay, self._least + (now - self._seen) * _DRIFT)
            self._seen = now
            time = stamp + round(self._least)
        self._last = time if self._last is None else max(time, self._last)
        return self._last + self.zero


class FrameClock:
    """The time of frames as a display needs it: it goes on between two frames, and never goes back.

    jumps: how often the clock of the frames went back by more than a second.

    Behind such a jump, as where two recordings were put together, time goes on from where it was: else what was heard before
    would look as if it had just come.
    """

    def __init__(self) -> None:
        self.jumps = 0
        self._ahead: Time = 0  # what was added for the jumps
        self._last: Time | None = None
        self._zero: Time = 0  # from trio's clock to this one

    def set(self, time: Time) -> Time:
        """Take the time of a frame that has just come, ns; return it on this clock."""
        shown = time + self._ahead
        if self._last is not None and shown < self._last:
            if self._last - shown > SECOND:
                self.jumps += 1
                self._ahead += self._last - shown
            shown = self._last
        self._last = shown
        self._zero = shown - trio_now()
        return shown

    def now(self) -> Time:
        """Return the present, ns."""
        return trio_now() + self._zero
