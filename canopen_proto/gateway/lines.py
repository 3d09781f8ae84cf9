"""`GatewayLines`: bytes of a stream cut into lines, of bounded length."""

from __future__ import annotations

from typing import Final

MAX_LINE: Final = 65_536
"""Bytes of a line: a value of 48 KiB as base64. A longer one is no request."""


class GatewayLines:
    """Cuts what comes into lines. too_long: a line was longer than `limit`; nothing is understood from there on.

    pending: bytes of a line that has no end yet.
    """

    def __init__(self, line_end: bytes = b"\n", limit: int = MAX_LINE) -> None:
        """line_end: what ends a line. limit: bytes of a line, without its end."""
        self._line_end = line_end
        self._limit = limit
        self._pending = bytearray()
        self.too_long = False

    @property
    def pending(self) -> int:
        """How many bytes wait for the end of their line."""
        return len(self._pending)

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes; return the lines that are whole now, without their ends. data: at most a few KiB at a time, of which
        what has no end yet is kept."""
        if self.too_long:
            return []
        searched = max(0, len(self._pending) - len(self._line_end) + 1)
        self._pending += data
        lines: list[bytes] = []
        begin = 0
        while (end := self._pending.find(self._line_end, max(begin, searched))) >= 0:
            if end - begin > self._limit:
                self._give_up()
                return lines
            lines.append(bytes(self._pending[begin:end]))
            begin = end + len(self._line_end)
        del self._pending[:begin]
        if len(self._pending) > self._limit + len(self._line_end) - 1:  # the last bytes may be the beginning of an end
            self._give_up()
        return lines

    def _give_up(self) -> None:
        self.too_long = True
        self._pending.clear()
