"""`FrameRing`: the last frames of a bus, in memory that never grows beyond its bound.

A frame takes 22 bytes of one buffer, so that a second costs nothing but its frames: no object is kept for any of them.
"""

from __future__ import annotations

from struct import Struct
from typing import Final, NamedTuple

from canopen_proto.frame import Frame
from canopen_proto.machine import Time

CAPACITY: Final = 1 << 18
"""Frames of one bus: 5.8 MB. A bus of 1 Mbit/s that is full of 8-byte frames brings as many in 33 s, a usual one in minutes."""

_ROW: Final = Struct("<qIBB8s")  # time, CAN-ID, flags, length and DLC, data
_SENT: Final = 0x80


class PassedFrame(NamedTuple):
    """A frame that has passed. time: ns, on the clock of whoever added it. is_sent: by us."""

    time: Time
    frame: Frame
    is_sent: bool


class FrameRing:
    """See this module's text. capacity: frames. count: of all frames so far. Frame n is there while first <= n < count."""

    def __init__(self, capacity: int = CAPACITY) -> None:
        self.capacity = capacity
        self.count = 0
        self._rows = bytearray(capacity * _ROW.size)

    @property
    def first(self) -> int:
        """The number of the oldest frame that is still there."""
        return max(0, self.count - self.capacity)

    def add(self, time: Time, frame: Frame, is_sent: bool) -> None:
        """Add a frame, in place of the oldest one if there is no room."""
        flags = frame.flags | _SENT if is_sent else frame.flags
        lengths = len(frame.data) << 4 | (frame.dlc & 0xF)
        _ROW.pack_into(self._rows, self.count % self.capacity * _ROW.size, time, frame.can_id, flags, lengths, frame.data)
        self.count += 1

    def at(self, number: int) -> PassedFrame:
        """Return the frame with a number, which has to be there."""
        return _frame_of(self._rows, number % self.capacity * _ROW.size)

    def since(self, time: Time) -> int:
        """Return the number of the first frame that is there and not older than a time. The times do not go back."""
        low, high = self.first, self.count
        while low < high:
            middle = (low + high) // 2
            if self.at(middle).time < time:
                low = middle + 1
            else:
                high = middle
        return low

    def copy(self, first: int, end: int) -> FrameCopy:
        """Return the frames with the numbers first to end - 1, as they are now. They have to be there. 15 ns for each."""
        begin, rest = first % self.capacity, end - first
        part = min(rest, self.capacity - begin)
        size = _ROW.size
        with memoryview(self._rows) as rows:  # so that they are copied once
            return FrameCopy(b"".join((rows[begin * size : (begin + part) * size], rows[: (rest - part) * size])))


class FrameCopy:
    """Frames that were copied out of a ring."""

    def __init__(self, rows: bytes) -> None:
        self._rows = rows

    def __len__(self) -> int:
        return len(self._rows) // _ROW.size

    def __getitem__(self, number: int) -> PassedFrame:
        return _frame_of(self._rows, number * _ROW.size)


def _frame_of(rows: bytes | bytearray, at: int) -> PassedFrame:
    time, can_id, flags, lengths, data = _ROW.unpack_from(rows, at)
    frame = Frame(can_id, data[: lengths >> 4], flags & ~_SENT, lengths & 0xF)
    return PassedFrame(time, frame, bool(flags & _SENT))
