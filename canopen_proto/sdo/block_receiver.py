"""The side of a block transfer that gets the data: the server in a download, the client in an upload.

block.py tells how a block transfer goes. Within a sub-block every frame but an abort (0x80) is a segment, whatever else its first
byte might mean: the sequence number decides. Segments are taken in order only. What is acknowledged, and when:

    the last segment of the sub-block came          those in order, at once; behind a gap too, but not before
    silence, and some segment came                  those in order (SEGMENT_TIMEOUT): the end of the sub-block was lost
    silence, and none came                          none (SUB_BLOCK_TIMEOUT), which asks for all: if a CRC guards us

The last one is a guess: that our acknowledgement was lost looks the same, and then the sender repeats the sub-block *before*,
which only a CRC reveals. Without one the transfer is given up instead. `timeout` ns after the last segment in order it is in
any case. A segment of less than eight bytes counts as lost.

A transfer is right if the CRC is (where both sides support it) and the size is (where it was announced). The CRC begins with 0,
so zeros at the beginning of the data do not count in it: while it is 0 it guards nothing, unless the size is known too.

In a stream each sub-block is a piece, handed on before it is acknowledged, and the acknowledgement waits until the piece was
taken. What the final sub-block holds is known only at the end, and goes with it.

Source: CiA 301 v4.2.0, 7.2.4.3.9 to 7.2.4.3.11 (download), 7.2.4.3.13 to 7.2.4.3.16 (upload, CRC).
"""

from __future__ import annotations

from binascii import crc_hqx
from typing import Final

from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_proto.sdo.abort import AbortCode, AbortOrigin
from canopen_proto.sdo.block import (
    ACKNOWLEDGE,
    ACKNOWLEDGEMENT,
    END,
    FINAL,
    KIND,
    SEGMENT_SIZE,
    SEGMENT_TIMEOUT,
    SEQUENCE,
    SUB_BLOCK_TIMEOUT,
    Party,
    chosen_block_size,
)
from canopen_proto.sdo.codec import ABORT

# States
STARTING: Final = 0  # the sender has not said that it is ready
_RECEIVING: Final = 1
HELD: Final = 2  # the next step is up to whoever takes the pieces
_ENDING: Final = 3  # the end frame is due


class BlockReceiver:
    """See this module's text. Subclasses say what follows from what, by the methods at the end."""

    __slots__ = (
        "_block_size", "_buffer", "_checked", "_crc", "_give_up_at", "_heard", "_is_stream", "_limit", "_party", "_received",
        "_size", "_state", "offset", "with_crc",
    )  # fmt: skip

    def __init__(self, party: Party, is_stream: bool) -> None:
        self._party = party
        self._is_stream = is_stream
        self.with_crc = False
        self._crc = 0
        self._checked = 0  # bytes of _buffer that are in the CRC
        self._buffer = bytearray()  # what came in order and was not handed on
        self.offset = 0  # of _buffer in the whole: what was handed on
        self._size: int | None = None  # announced
        self._limit = 0  # of the whole
        self._block_size = 0
        self._received = 0  # segments of this sub-block, in order
        self._heard = False  # segments of this sub-block, out of order
        self._give_up_at: Time = 0
        self._state = STARTING

    def stragglers(self) -> tuple[int, Time]:
        """If the transfer ends now: the number of the segment that may come nevertheless (0: none), and until when it may."""
        if self._state != _RECEIVING:
            return 0, 0
        heard = self._party._last[0] & SEQUENCE if self._received or self._heard else 0
        return (heard + 1) & SEQUENCE, self._give_up_at - self._party.timeout + SEGMENT_TIMEOUT

    # ---- inputs ----

    def receive(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        if self._state != _RECEIVING or command == ABORT:
            if self._state == _ENDING and command & KIND == END and self._on_end(command, data, frame, now):
                return
            self._on_other(command, data, frame, now)
            return
        party = self._party
        sequence = command & SEQUENCE
        if sequence != self._received + 1 or data is not frame.data:
            self._on_gap(command, sequence, data, frame, now)
            return
        self._buffer += data[1:]
        self._received = sequence
        party._last = data
        self._give_up_at = now + party.timeout
        if command & FINAL or sequence == self._block_size:
            self._end_sub_block(command & FINAL, now)
            return
        party.deadline = deadline = now + SEGMENT_TIMEOUT
        if deadline < party._wake:
            party._arm(deadline)

    def handle_timeout(self, now: Time) -> None:
        if self._state == HELD:
            self._party._fail(AbortCode.CANNOT_TRANSFER, AbortOrigin.TIMEOUT, now)
        elif self._state != _RECEIVING or now >= self._give_up_at:
            self._party._fail(AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT, now)
        elif self._received or self._heard or (self.with_crc and (self._crc or self._size is not None)):
            self._end_sub_block(0, now)
        else:
            self._party._arm(self._give_up_at)

    # ---- the transfer ----

    def _start(self, size: int | None, limit: int, with_crc: bool, now: Time) -> None:
        """The segments will come now. size: as announced. limit: of the whole, in bytes. The block size has been told already."""
        self._size = size
        self._limit = limit if size is None else size
        self.with_crc = with_crc
        self._state = _RECEIVING
        self._give_up_at = now + self._party.timeout
        self._listen(now)

    def _listen(self, now: Time) -> None:
        """For the first segment of a sub-block."""
        self._received = 0
        self._heard = False
        self._party._arm(min(now + SUB_BLOCK_TIMEOUT, self._give_up_at))

    def _choose_block_size(self) -> int:
        """Of the next sub-block."""
        is_safe = self.with_crc and self._size is not None
        self._block_size = chosen_block_size(self._party.block_size, is_safe)
        return self._block_size

    def _on_gap(self, command: int, sequence: int, data: bytes, frame: Frame, now: Time) -> None:
        """Not the segment that is due."""
        party = self._party
        if data == party._last:
            party._ignore(frame, "second copy of the last frame")
        elif len(frame.data) < 8:
            self._heard = True
            party._ignore(frame, "too short for a segment")
        elif not 1 <= sequence <= self._block_size:
            party._fail(AbortCode.INVALID_SEQUENCE_NUMBER, AbortOrigin.LOCAL, now)
        elif sequence == self._received + 1:
            self.receive(command, data, Frame(frame.can_id, data, frame.flags), now)  # more than eight bytes: the first count
        else:
            self._heard = True
            party._last = data
            if command & FINAL or sequence == self._block_size:
                self._end_sub_block(0, now)
            else:
                party._arm(min(now + SEGMENT_TIMEOUT, self._give_up_at))

    def _end_sub_block(self, is_final: int, now: Time) -> None:
        """Acknowledge what came in order, as soon as it may be."""
        party = self._party
        excess = self.offset + len(self._buffer) - SEGMENT_SIZE - self._limit
        if excess > 0:
            code = AbortCode.OUT_OF_MEMORY if self._size is None else AbortCode.LENGTH_TOO_HIGH
            party._fail(code, AbortOrigin.LOCAL, now)
        elif is_final:
            self._acknowledge()
            self._state = _ENDING
            party._arm(now + party.timeout)
        elif self._is_stream and self._received:
            self._check(len(self._buffer))
            self._state = HELD
            party._arm(now + party.stream_timeout)
            piece, self._buffer, self._checked = bytes(self._buffer), bytearray(), 0
            offset, self.offset = self.offset, self.offset + len(piece)
            self._piece(piece, offset, now)
        else:
            self._check(len(self._buffer))
            self._acknowledge()
            self._listen(now)

    def _go_on(self, now: Time) -> None:
        """The piece was taken."""
        self._acknowledge()
        self._state = _RECEIVING
        self._give_up_at = now + self._party.timeout
        self._listen(now)

    def _acknowledge(self) -> None:
        """7.2.4.3.10 and 7.2.4.3.14"""
        received = self._received
        self._party._send(ACKNOWLEDGE.pack(ACKNOWLEDGEMENT, received, self._choose_block_size()))

    def _check(self, end: int) -> None:
        """Take the buffer's bytes into the CRC, up to `end`."""
        if self.with_crc:
            self._crc = crc_hqx(self._buffer[self._checked : end], self._crc)
            self._checked = end

    def _on_end(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        """7.2.4.3.11 and 7.2.4.3.15. False if it is no end frame.

        The final segment may look like one (0xC1 is the end, and number 65): then it is the end only if it is right as such.
        """
        end = len(self._buffer) - (command >> 2 & 7)
        is_doubtful = data == self._party._last
        if is_doubtful and not self.with_crc and self._size is None:
            return False
        crc = crc_hqx(self._buffer[self._checked : end], self._crc)
        if self.with_crc and crc != data[1] | data[2] << 8:
            fault: AbortCode | None = AbortCode.CRC_ERROR
        elif self._size is not None and self.offset + end != self._size:
            fault = AbortCode.LENGTH_TOO_HIGH if self.offset + end > self._size else AbortCode.LENGTH_TOO_LOW
        elif self.offset + end > self._limit:
            fault = AbortCode.OUT_OF_MEMORY
        else:
            fault = None
        if fault is not None:
            if is_doubtful:
                return False
            self._party._fail(fault, AbortOrigin.LOCAL, now)
            return True
        self._party._last = data
        del self._buffer[end:]
        self._complete(now)
        return True

    # ---- what subclasses say ----

    def _piece(self, piece: bytes, offset: int, now: Time) -> None:
        """A piece of a stream came; `_go_on` once it was taken."""
        raise NotImplementedError

    def _complete(self, now: Time) -> None:
        """All of it is in `_buffer` (behind `offset`), and right; the end response is due."""
        raise NotImplementedError

    def _on_other(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """A frame that is neither a segment nor an end that is due."""
        raise NotImplementedError
