"""The bounded queue of lines for one member of a bus server; it marks lost lines at their place. Pure."""

from __future__ import annotations

from collections import deque
from itertools import islice
from typing import Final

from canopen_transports.tcp.framing import bye_line, lost_line

QUEUE_SIZE: Final = 8192
"""Lines, as many as a receive queue has frames: one second of a fully loaded 1 Mbit/s bus. The system's own buffers come on top;
on Linux they hold some megabytes."""
BATCH: Final = 512
"""Lines that are written at once: some 10 KB."""


class Outgoing:
    """Lines for one member. One `lost` line marks a loss at its place, however many lines are missing there. size: how many lines
    it holds."""

    def __init__(self, size: int = QUEUE_SIZE) -> None:
        self._size = size
        self._lines: deque[bytes] = deque()
        self._lost = 0

    def __bool__(self) -> bool:
        return bool(self._lines or self._lost)

    def put(self, line: bytes) -> None:
        """Add a line with its end, or count it as lost."""
        if len(self._lines) >= self._size:
            self._lost += 1
            return
        if self._lost:
            self._lines.append(lost_line(self._lost))
            self._lost = 0
        self._lines.append(line)

    def end(self, reason: str) -> None:
        """Replace what waits by the reason why the member is cut off."""
        self._lines.clear()
        self._lost = 0
        self._lines.append(bye_line(reason))

    def take(self) -> bytes:
        """Return the bytes to write next."""
        lines = self._lines
        taken = list(islice(lines, BATCH))
        for _ in taken:
            lines.popleft()
        if self._lost and not lines:
            taken.append(lost_line(self._lost))
            self._lost = 0
        return b"".join(taken)
