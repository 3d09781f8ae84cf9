"""`StampClock`: turns a transport's time stamps into our times."""

from __future__ import annotations

from typing import Final

from canopen_proto.machine import SECOND, Time

_DRIFT: Final = 200e-6
"""The difference of two quartz clocks is smaller: each is within 100 ppm."""
_STALE: Final = 2 * SECOND
"""A frame that seems to have waited for longer did not wait: its clock was set back."""
_SPAN: Final = SECOND
"""If all frames that are handed over in so long a time seem to have waited, none of them did: its clock was set back."""


class StampClock:
    """Turns the time stamps of a transport into times on another clock of ours.

    A frame comes some time after its stamp, never before it. So the shortest such delay is the difference of the two clocks; it
    is allowed to grow slowly, as one of them is faster. A clock that is set back makes all delays longer, and not only those of
    frames that waited. zero: is added to each time.
    """

    def __init__(self, zero: Time = 0) -> None:
        self.zero = zero
        self._least: float | None = None
        self._seen: Time = 0
        self._begun: Time = 0  # the span under way, and its shortest delay
        self._shortest: float = 0
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
                self._least, self._begun, self._shortest = delay, now, delay
            elif now - self._begun >= _SPAN:
                self._least = max(self._least, self._shortest)
                self._begun, self._shortest = now, delay
            self._shortest = min(delay, self._shortest)
            self._least = min(delay, self._least + (now - self._seen) * _DRIFT)
            self._seen = now
            time = stamp + round(self._least)
        self._last = time if self._last is None else max(time, self._last)
        return self._last + self.zero
