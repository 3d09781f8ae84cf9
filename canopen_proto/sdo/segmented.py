"""Segmented transfer: what is the same in a client and in a server.

Each segment is asked for or acknowledged before the next one goes. A toggle bit, 0 in the first segment, alternates in the
segments and in what is said to them. `due` is the command byte of a plain segment, request or acknowledgement that comes next:
what differs from it in the toggle is a copy or a fault.

    download    client   segment ------------------>  <------------- acknowledgement, same toggle    server
    upload      client   request ------------------>  <--------------------- segment, same toggle    server

Source: CiA 301 v4.2.0, 7.2.4.3.4 and 7.2.4.3.7.
"""

from __future__ import annotations

from canopen_proto.abort import AbortCode
from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_proto.sdo.codec import LAST, SPECIFIER, TOGGLE
from canopen_proto.sdo.transfer import SEGMENTS, UNKNOWN_SIZE, Transfer


class SegmentedTransfer(Transfer):
    """A transfer whose frames alternate their toggle."""

    __slots__ = ("due",)

    due: int  # while the state is SEGMENTS or HELD

    def fault_of(self, command: int) -> AbortCode:
        is_like_it = self.state is SEGMENTS and (command ^ self.due) & SPECIFIER == 0
        return AbortCode.TOGGLE_NOT_ALTERNATED if is_like_it else AbortCode.INVALID_COMMAND


class SegmentReceiver(SegmentedTransfer):
    """The side that gets the data: the client in an upload, the server in a download. Subclasses say what is done with them."""

    __slots__ = ("_announced", "_buffer", "_frames", "_limit", "_piece_size", "_plain", "_size")

    # From `_start` on. `_take` empties the two buffers.
    _announced: int  # bytes that are still to come, or UNKNOWN_SIZE
    _size: int  # bytes that came
    _buffer: bytearray  # their first ones
    _frames: bytearray  # full segments behind these, as whole frames: without a copy of each one's data
    _limit: int  # of _size
    _piece_size: int  # of _size, from which on they are handed over
    _plain: int  # of _size: below, a full segment is simply one of many

    def _start(self, specifier: int, size: int, limit: int, piece_size: int, reply: Frame, now: Time) -> None:
        """Send `reply`, and wait for the first segment. size: as announced, or UNKNOWN_SIZE; then `limit` counts."""
        self._buffer = bytearray()
        self._frames = bytearray()
        self._size = 0
        self._announced = size
        self._limit = limit if size == UNKNOWN_SIZE else size
        self._piece_size = piece_size
        self._plain = min(self._limit, piece_size)
        self.due = specifier
        self._go_on(reply, now)

    def _go_on(self, reply: Frame, now: Time) -> None:
        """Send `reply`, and wait for the next segment."""
        end = self.end
        end.out.frames.append(reply)
        self.state = SEGMENTS
        self.deadline = now + (self.own_timeout or end.timeout)

    def receive(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        if self.state is not SEGMENTS:
            return self._on_answer(command, data, now)
        due = self.due
        if command == due:  # seven bytes, and others follow
            size = self._size = self._size + 7
            frames = self._frames
            frames += data
            if size < self._plain:
                end = self.end
                end.last = data
                self.due = due ^ TOGGLE
                end.out.frames.append(end.replies[due >> 4 & 1])
                self.deadline = now + (self.own_timeout or end.timeout)
                return True
        elif command & ~0x0F == due:
            self._unpack()
            self._buffer += data[1 : 8 - (command >> 1 & 7)]
            self._size = len(self._buffer)
        else:
            return False
        self._judge(command, data, now)
        return True

    def _judge(self, command: int, data: bytes, now: Time) -> None:
        """Act on a segment that may be the last one, of all or of a piece, or one too many."""
        end, due, size = self.end, self.due, self._size
        reply = end.replies[due >> 4 & 1]
        if size > self._limit:
            self.abort(AbortCode.OUT_OF_MEMORY if self._announced == UNKNOWN_SIZE else AbortCode.LENGTH_TOO_HIGH)
        elif command & LAST:
            if size < self._announced:
                self.abort(AbortCode.LENGTH_TOO_LOW)
            else:
                end.last = data
                self._complete(self._take(), reply, now)
        elif command & 0x0E == 0x0E:  # no data and yet not the last: without this a transfer might never end
            self.abort(AbortCode.INVALID_COMMAND)
        else:
            end.last = data
            self.due = due ^ TOGGLE
            if size >= self._piece_size:
                self._hand_over(self._take(), reply, now)
            else:
                end.out.frames.append(reply)
                self.deadline = now + (self.own_timeout or end.timeout)

    def _unpack(self) -> None:
        """Move the data of the full segments into the buffer."""
        frames = self._frames
        del frames[::8]  # the command byte of each
        if self._buffer:
            self._buffer += frames
            frames.clear()
        else:  # nearly always: no second copy of a large object
            self._frames, self._buffer = self._buffer, frames

    def _take(self) -> bytes:
        """Return all that came, and hold it no longer."""
        self._unpack()
        content = bytes(self._buffer)
        self._buffer.clear()
        self._size = 0
        return content

    # ---- what subclasses say ----

    def _on_answer(self, command: int, data: bytes, now: Time) -> bool:
        """Take a frame while no segment is due. False if it is none that is."""
        return False

    def _complete(self, content: bytes, reply: Frame, now: Time) -> None:
        """All of it is there, or the last piece. reply: what acknowledges the last segment."""
        raise NotImplementedError

    def _hand_over(self, piece: bytes, reply: Frame, now: Time) -> None:
        """Give a piece to the user; `reply` once it has taken that."""
        raise NotImplementedError
