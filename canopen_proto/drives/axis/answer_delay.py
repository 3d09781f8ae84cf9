"""`AnswerDelay`: whether the positions of a drive come late, which looks like a following error.

A drive answers each SYNC by one PDO with its position. On a bus without room, SYNCs and PDOs wait in the queues, longer and
longer: the positions are old then, and lie on the path where the drive was. So the PDOs that are missing behind the SYNCs are
counted. A position is late by so many SYNCs if it is that of the set-point of so many SYNCs before. The second condition tells
late PDOs from lost ones.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from typing import Final

from canopen_proto.multiplexer import Mux

REMEMBERED: Final = 512
"""SYNCs back to which a late position is recognised: 2 s at 4 ms."""
FEW: Final = 3
"""Missing answers that prove nothing: one may be under way, and frames are lost."""
AROUND: Final = 2
"""How many SYNCs more or less the set-point of a late position may lie back."""
MAX_PDOS: Final = 4
"""PDOs with a position, of one drive."""


class AnswerDelay:
    """See this module's text. It has no clock: the caller tells it each SYNC and each PDO."""

    __slots__ = ("_answers", "_points", "_syncs")

    def __init__(self) -> None:
        self._syncs = 0
        self._answers: dict[int, int] = {}
        self._points: deque[int] = deque(maxlen=REMEMBERED)

    def begin(self, point: int) -> None:
        """Begin to count. point: the present set-point, in counts."""
        self._syncs = 0
        self._answers.clear()
        self._points.clear()
        self._points.append(point)

    def on_sync(self, point: int) -> None:
        """Count a SYNC, which takes this set-point along."""
        self._syncs += 1
        self._points.append(point)

    def on_position(self, muxes: Collection[Mux]) -> None:
        """Count a PDO with the position: the same collection for each PDO of one kind. One that is alone may have been read."""
        key = id(muxes)
        if key in self._answers:
            self._answers[key] += 1
        elif len(muxes) > 1 and len(self._answers) < MAX_PDOS:
            self._answers[key] = 1

    def late(self, position: int, lag: int, window: int) -> int:
        """Return by how many SYNCs a position is late; 0 if nothing shows that. lag: SYNCs until a set-point is reached. window:
        counts that the position may be off."""
        missing = self._syncs - max(self._answers.values(), default=self._syncs)
        newest = len(self._points) - 1 - lag - missing
        around = range(max(0, newest - AROUND), min(len(self._points), newest + AROUND + 1))
        is_on_path = any(abs(self._points[place] - position) <= window for place in around)
        return missing if missing > FEW and is_on_path else 0
