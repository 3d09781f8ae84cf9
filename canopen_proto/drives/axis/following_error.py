"""`FollowingError`: how far one drive is off its set-points, cycle by cycle.

The error is the set-point of a cycle minus the position of the same cycle: a set-point sent behind SYNC n is reached at SYNC
n + `lag`, whose PDO shows it. This pairing may be some cycles wrong: adapters hold frames back, and drives buffer set-points. So
the limit is compared with the distance from the position to the nearest set-point, up to UNCERTAIN cycles earlier or later. A
drive in profile position has a profile of its own, and may be further behind (`slack`): it is seen that much later that such a
drive has stopped.

**Late positions.** On a bus without room, SYNCs and PDOs wait in the queues, longer and longer. Positions are old then, lie on
the path where the drive was, and look like a following error. So the PDOs that are missing behind the SYNCs are counted. A
position is late by so many SYNCs if it is that of the set-point of so many SYNCs before. The second condition tells late PDOs
from lost ones.

Source: IEC 61800-7-201 (CiA 402-2): following error, following error window 6065h.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from itertools import islice
from typing import Final

from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.limits import Limit
from canopen_proto.drives.cia402 import objects
from canopen_proto.multiplexer import Mux

LAG: Final = 2
"""SYNCs from sending a set-point to reaching it: sent behind SYNC n, taken at n + 1, reached at n + 2, whose PDO shows it."""
UNCERTAIN: Final = 2
"""How many cycles earlier or later the set-point of a position may lie."""

REMEMBERED: Final = 512
"""SYNCs back to which a late position is recognised: 2 s at 4 ms."""
FEW: Final = 3
"""Missing PDOs that prove nothing: one may be under way, and frames are lost."""
AROUND: Final = 2
"""How many SYNCs more or less the set-point of a late position may lie back."""
MAX_PDOS: Final = 4
"""PDOs with a position, of one drive."""


class FollowingError:
    """The following error of one drive. It has no clock: it is told each SYNC and each position.

    limit: of the error, in the user's unit. present: as last seen, in the user's unit. largest: the largest absolute one so far.
    """

    def __init__(self, axis: Axis) -> None:
        self.limit = Limit(0.0, "")
        self.present = self.largest = 0.0
        self._axis = axis
        self._store = axis.node.values.store  # as near as can be: looked at for each PDO
        self._lag = LAG
        self._window = 1  # set-points that a position is compared with
        self._points: deque[int] = deque()  # the set-points of the last SYNCs, in counts
        self._position = 0  # the last one that came, in counts
        self._syncs = 0
        self._pdos: dict[int, int] = {}  # how many came of each kind of PDO with a position

    def begin(self, limit: Limit, lag: int, slack: int) -> None:
        """Begin with a drive that stands at the present set-point. limit, lag, slack: as of `Following.begin`."""
        self.limit, self._lag, self._window, self.present = limit, lag, lag + slack + 1, 0.0
        self._points = deque([self._axis.set_points.counts] * (lag + 1), maxlen=max(self._window, REMEMBERED))
        self._syncs = 0
        self._pdos.clear()

    def on_sync(self) -> None:
        """Take note of a SYNC, which takes the present set-point along."""
        self._points.append(self._axis.set_points.counts)
        self._syncs += 1

    def on_position(self, muxes: Collection[Mux]) -> bool:
        """Take note of a position that has come; return whether it needs a look: its own set-point is beyond the limit.

        muxes: the same collection for each PDO of one kind. A position that comes alone may have been read: it is not counted.
        """
        kind = id(muxes)
        if kind in self._pdos:
            self._pdos[kind] += 1
        elif len(muxes) > 1 and len(self._pdos) < MAX_PDOS:
            self._pdos[kind] = 1
        counts = self._store[objects.POSITION_ACTUAL_VALUE]  # it has just come
        if not isinstance(counts, int):
            counts = 0
        self._position = counts
        self.present = present = self._axis.scale.way_from_counts(self._points[-1 - self._lag] - counts)
        distance = abs(present)
        if distance > self.largest:
            self.largest = distance
        return distance > self.limit.value

    def excess(self) -> tuple[float, float, float, float, str] | None:
        """Return how far the drive is off its path, its position, its set-point, the limit and its source; None if it is within
        the limit. All are in the user's unit."""
        axis, limit, position = self._axis, self.limit, self._position
        points = list(islice(reversed(self._points), self._window))
        off = axis.scale.amount_from_counts(max(min(points) - position, position - max(points)))
        if off <= limit.value:
            return None
        return off, axis.scale.from_counts(position), axis.scale.from_counts(points[self._lag]), limit.value, limit.source

    def late(self) -> int:
        """Return by how many SYNCs the last position is late; 0 if nothing shows that."""
        points = self._points
        missing = self._syncs - max(self._pdos.values(), default=self._syncs)
        newest = len(points) - 1 - self._lag - missing
        around = range(max(0, newest - AROUND), min(len(points), newest + AROUND + 1))
        window = round(self._axis.scale.counts_of_amount(self.limit.value))
        is_on_path = any(abs(points[place] - self._position) <= window for place in around)
        return missing if missing > FEW and is_on_path else 0
