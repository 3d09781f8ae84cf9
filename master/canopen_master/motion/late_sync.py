"""`WithinReach`: behind a late SYNC, it keeps each joint within the way that its speed allows.

Each set-point is one step of the path from the last one, and a drive has one period of SYNC for it. A process that stalls breaks
that in two ways:

    a drive gets less than a period    a late SYNC is followed by the next one in less than a period, since SYNC keeps its phase.
                                       The step that is under way then is made as much shorter
    a drive is not where it was sent   without SYNC drives do what their makers chose: some stop at the last set-point, others go
                                       on beyond it, and brake. The next set-point, which waits in the drive, may lie far behind
                                       such a drive then: at five steps' distance it asks for five times the speed

A drive that was told to go at the speed v is somewhere on the way that it makes at v in the time of the gap. If the set-point
that waits is within one period's way at the joint's speed limit from all of it, SYNC may be sent. Else the master has to ask the
drive where it is, and make that its set-point, before (`must_look`, `stand_at`).

A joint that is off its set-points then comes back to them by RETURN of its speed, while they go on. On its way it is not sent
beyond its position limits; a joint that has left them is not sent any further.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, TypeAlias

RETURN: Final = 0.2
"""The share of a joint's speed limit at which it comes back to its path: slow enough to begin and end it at once."""

Range: TypeAlias = tuple[float | None, float | None]
"""The lowest and the highest position of a joint; None: no limit."""

_EXACT: Final = 1 + 1e-6
"""No drive is asked because of a rounding error."""


class WithinReach:
    """The set-points of several joints, as they go out; see this module's text. sent: the last ones. ways: see `__init__`."""

    __slots__ = ("_acted_on", "_before", "_next", "_next_off", "_off", "_ranges", "sent", "ways")

    def __init__(self, start: Sequence[float], ways: Sequence[float], ranges: Sequence[Range] = ()) -> None:
        """start: where the joints stand. ways: of each joint in one period, at its speed limit; inf: it has none. ranges: of
        their positions; none: they have no limits."""
        self.ways = ways
        self._ranges = [_within(each) for each in ranges] or [(-math.inf, math.inf)] * len(start)
        self.stand_at(start, start)

    @property
    def is_on_path(self) -> bool:
        """Whether all joints are sent where they are wanted."""
        return not any(self._off)

    def stand_at(self, positions: Sequence[float], wanted: Sequence[float]) -> None:
        """Go on from where the joints are. wanted: where they should be. positions: one for each joint, in its unit."""
        self._before = self._acted_on = self.sent = self._next = positions
        self._off = self._next_off = [at - each for at, each in zip(positions, wanted, strict=True)]

    def must_look(self, periods: float) -> bool:
        """Return whether a joint may be out of reach of its set-point. periods: how late the present SYNC is."""
        return _must_look(self._before, self._acted_on, self.sent, self.ways, periods)

    def must_look_ahead(self, periods: float) -> bool:
        """As `must_look`, if the next set-points are taken at the present SYNC, since they are sent right before it. periods: how
        late it is."""
        return _must_look(self._acted_on, self.sent, self._next, self.ways, periods)

    def next(self, wanted: Sequence[float], share: float = 1.0) -> Sequence[float]:
        """Return what to send in place of these set-points. share: of a period, until the SYNC behind which they are taken.
        wanted: one for each joint, in its unit.

        It may be called again, with other set-points, until `on_sent`.
        """
        if share >= 1.0 and self.is_on_path:
            self._next, self._next_off = wanted, self._off
            return wanted
        self._next, self._next_off = [], []
        each = zip(wanted, self._off, self.sent, self.ways, self._ranges, strict=True)
        for position, off, sent, way, (lowest, highest) in each:
            way *= share
            back = min(abs(off), RETURN * way)
            step = position + off - math.copysign(back, off) - sent if back < abs(off) else position - sent
            to = position if back == abs(off) and abs(step) <= way else sent + math.copysign(min(abs(step), way), step)
            to = min(max(to, min(lowest, sent)), max(highest, sent))
            self._next.append(to)
            self._next_off.append(to - position)
        return self._next

    def on_sent(self) -> None:
        """Note that the next ones were sent, and that the drives act on those before."""
        self._before, self._acted_on, self.sent = self._acted_on, self.sent, self._next
        self._off = self._next_off


def _must_look(
    before: Sequence[float], acted_on: Sequence[float], sent: Sequence[float], ways: Sequence[float], periods: float
) -> bool:
    each = zip(before, acted_on, sent, ways, strict=True)
    return any(abs(to - at - (at - came_from) * periods) > way * _EXACT for came_from, at, to, way in each)


def _within(limits: Range) -> tuple[float, float]:
    lowest, highest = limits
    return -math.inf if lowest is None else lowest, math.inf if highest is None else highest
