"""`PatientClock`: the time of a world that is simulated as a whole in this process, and stands still while the process does.

A busy computer lets a process wait for tenths of a second. In real time a master and its simulated drives would then find all
their deadlines over at once: SYNC late, heartbeats lost. But nothing moves outside this process. So its time need not pass:

- it stops at each deadline that trio's loop sleeps for, until the loop has seen that deadline, however late that is;
- while the loop works, it goes on by AT_ONCE at most from one look at the clock to the next.

So no deadline is seen much later than it was due, unless the work itself takes too long. Time that is left out because of a
wake-up that comes a little late is made up for in the next sleeps (MADE_UP); what is beyond that is gone, and `lost` counts it.

    clock = PatientClock()
    trio.run(main, clock=clock)         # main opens a master and simulated devices on buses `virtual:...`, and nothing else

Never use it where anything on a bus is outside this process: a real drive does not wait.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from time import perf_counter
from typing import Final

import trio

AT_ONCE: Final = 0.001
"""Seconds. Ordinary work looks at the clock more often; a scheduler takes the processor away for longer."""

MADE_UP: Final = 0.002
"""Seconds. trio's loop sleeps by whole milliseconds, rounded up. More would let the world run ahead of a script beside it."""


class PatientClock(trio.abc.Clock):
    """trio's clock for such a world; see this module's text. lost: seconds by which its time is behind the real one so far.

    real: the real time, in seconds.
    """

    has_to_know_deadlines = True
    """No alarm may wake the loop but trio's own: see `TrioLoop.is_real_time`."""

    def __init__(self, real: Callable[[], float] = perf_counter) -> None:
        self.lost = 0.0
        self._real = real
        self._thread = 0
        self._seen = 0.0, 0.0  # this time and the real one, as the loop last saw them
        self._to_make_up = 0.0
        self._sleeps_until = -math.inf

    def start_clock(self) -> None:
        self._thread = threading.get_ident()
        self._seen = 0.0, self._real()
        self._to_make_up, self._sleeps_until = 0.0, -math.inf

    def current_time(self) -> float:
        """Return the time in seconds since the start. Another thread may ask, too: that changes nothing."""
        time, before = self._seen
        real, until, to_make_up = self._real(), self._sleeps_until, self._to_make_up
        reached, latest = time + real - before, time + AT_ONCE
        if until >= time:  # the loop has slept, or still does
            reached, latest, to_make_up = reached + to_make_up, max(latest, until), 0.0
        now = min(reached, latest)
        if threading.get_ident() == self._thread:
            self._seen, self._sleeps_until = (now, real), -math.inf
            left_out = reached - now + to_make_up
            self._to_make_up = min(left_out, MADE_UP)
            self.lost += left_out - self._to_make_up
        return now

    def deadline_to_sleep_time(self, deadline: float) -> float:
        """Return the real seconds until this time. Called by trio's loop before it sleeps. deadline: s on trio's clock."""
        time, before = self._seen
        self._sleeps_until = deadline
        return deadline - time - (self._real() - before) - self._to_make_up


def present_patient_clock() -> PatientClock | None:
    """Return the clock of the present `trio.run`, if it is a patient one."""
    clock = trio.lowlevel.current_clock()
    return clock if isinstance(clock, PatientClock) else None
