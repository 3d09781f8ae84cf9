"""`FrameClock`: the time of what is live goes on between frames."""

from __future__ import annotations

import trio

from canopen_proto.machine import SECOND, Time


def trio_now() -> Time:
    """Return the present on trio's clock, ns."""
    return round(trio.current_time() * SECOND)


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
