"""The side of a block transfer that gets the data: the server in a download, the client in an upload.

block.py tells how a block transfer goes. Within a sub-block every frame but an abort (0x80) is a segment, whatever else its first
byte might mean: the sequence number decides. Segments are taken in order only. What is acknowledged, and when:

    the last segment of the sub-block came          those in order, at once; behind a gap too, but not before
    silence, and some segment came                  those in order: the end of the sub-block was lost, or the sender pauses
    silence, and none came                          our last frame again, if CRC and size guard the transfer. If only one
                                                    segment is due, we ask for that segment
    a second silence                                the transfer is aborted

A silence lasts `silence_limit`; it is a second one if no segment came in order since the first. A sender that only paused goes
on with the numbers of its sub-block; one whose last segments were lost begins with 1. So if the next number is higher than all
before the early acknowledgement, the transfer ends: the bytes can't be wrong, even without CRC. That holds too while the
acknowledgement waits for a piece to be taken. Once number 1 has come, nothing of the old sub-block can follow. If nothing came
before the silence, such a sign is missing, and a sender that only pauses may take our repetition for the next acknowledgement:
CRC and size have to guard it.

On CAN the numbers of a sub-block only rise. A number that was received already, with other data, shows a frame out of its order:
one of the two is of another sub-block. With a CRC all of the sub-block is asked for again; without one that is an abort. Between
two sub-blocks, and when all have come, segments with numbers that no request has, and those that go on behind them, are late, or
their sender is a sub-block ahead: they are ignored. A segment of less than eight bytes counts as lost.

A transfer is right if the CRC is (where both sides support it) and the size is (where it was announced). The CRC begins with 0,
so zeros at the beginning of the data do not count in it: while it is 0 it guards nothing, unless the size is known too.

In a stream each sub-block is a piece, handed on before it is acknowledged, and the acknowledgement waits until the piece was
taken. What the final sub-block holds is known only at the end, and goes with it.

Source: CiA 301 v4.2.0, 7.2.4.3.9 to 7.2.4.3.11 (download), 7.2.4.3.13 to 7.2.4.3.16 (upload, CRC).
"""

from __future__ import annotations

from binascii import crc_hqx
from typing import Final

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_proto.sdo.block import (
    ACKNOWLEDGE,
    ACKNOWLEDGEMENT,
    END,
    FINAL,
    KIND,
    MAX_BLOCK_SIZE,
    MAX_STALLS,
    SEGMENT_SIZE,
    SEQUENCE,
    Party,
    chosen_block_size,
    is_next,
    next_number,
    silence_limit,
)
from canopen_proto.sdo.codec import ABORT

# States
STARTING: Final = 0  # the sender has not said that it is ready
_RECEIVING: Final = 1
HELD: Final = 2  # the next step is up to whoever takes the pieces
_ENDING: Final = 3  # the end frame is due

_BEHIND_A_GAP: Final = -1
"""The number that is due then: none is taken before the sub-block is over."""


class BlockReceiver:
    """See this module's text. Subclasses say what follows from what, by the methods at the end."""

    __slots__ = (
        "_block_size", "_buffer", "_checked", "_crc", "_due", "_heard", "_is_stream", "_last_said", "_limit", "_party",
        "_paused_behind", "_received", "_silence", "_size", "_stalls", "_state", "_was_silent", "offset", "with_crc",
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
        self._due = 1  # the number that is taken next
        self._heard = 0  # the highest number behind the gap
        self._paused_behind = 0  # the highest number before an early acknowledgement; 0: there was none
        self._was_silent = False  # for as long as _silence, since the last segment in order
        self._silence = silence_limit(party.timeout)
        self._stalls = 0  # acknowledgements of nothing, one behind the other
        self._last_said = b""  # what to repeat if it may have been lost
        self._state = STARTING

    @property
    def has_begun(self) -> bool:
        """Whether the initiation is over."""
        return self._state != STARTING

    @property
    def straggler(self) -> int:
        """If the transfer ends now: the number of the segment that may be next in the sender's queue.

        Above MAX_BLOCK_SIZE: the sub-block is over, but the sender may have begun another.
        """
        if self._state >= HELD and not self._paused_behind:
            return self._due
        heard = max(self._received, self._heard) or self._paused_behind
        return heard + 1 if heard < self._block_size else MAX_BLOCK_SIZE + 1

    # ---- inputs ----

    def receive(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        if self._state != _RECEIVING or command == ABORT:
            if self._state == _ENDING and command & KIND == END and self._on_end(command, data, frame, now):
                return
            sequence = command & SEQUENCE
            if self._state != STARTING and data == self._party._last:
                self._party._ignore(frame, "second copy of the last frame")
            elif self._state == HELD and 0 < self._paused_behind < sequence <= self._block_size:
                self._refuse_number(sequence, now)
            elif self._state >= HELD and is_next(command, self._due):
                self._due = next_number(command)
                self._party._ignore(frame, "segment out of its order")
            else:
                self._on_other(command, data, frame, now)
            return
        party = self._party
        sequence = command & SEQUENCE
        if sequence != self._due or data is not frame.data:
            self._on_gap(command, sequence, data, frame, now)
            return
        self._buffer += data[1:]
        self._received = sequence
        self._due = sequence + 1
        party._last = data
        if command & FINAL or sequence == self._block_size:
            self._end_sub_block(command & FINAL, now)
            return
        party.deadline = deadline = now + self._silence
        if deadline < party._wake:
            party._arm(deadline)

    def handle_timeout(self, now: Time) -> None:
        if self._state == HELD:
            self._party._fail(AbortCode.CANNOT_TRANSFER, AbortOrigin.TIMEOUT, now)
        elif self._state == _RECEIVING and (self._received or (self._heard and not self._was_silent)):
            self._end_sub_block(0, now, is_early=True)
        elif self._state == STARTING or self._was_silent:
            self._party._fail(AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT, now)
        else:
            self._was_silent = True
            self._remind()
            self._party._arm(now + self._silence)

    # ---- the transfer ----

    def _start(self, size: int | None, limit: int, with_crc: bool, now: Time) -> None:
        """The segments will come now. size: as announced. limit: of the whole, in bytes. The block size has been told already."""
        self._size = size
        self._limit = limit if size is None else size
        self.with_crc = with_crc
        self._listen(now)

    def _listen(self, now: Time) -> None:
        """For the first segment of a sub-block."""
        self._state = _RECEIVING
        self._received = 0
        self._due = 1
        self._heard = 0
        self._party._arm(now + self._silence)

    def _choose_block_size(self) -> int:
        """Of the next sub-block."""
        self._block_size = chosen_block_size(self._party.block_size)
        return self._block_size

    def _on_gap(self, command: int, sequence: int, data: bytes, frame: Frame, now: Time) -> None:
        """Not the segment that is due."""
        party = self._party
        if data == party._last:
            party._ignore(frame, "second copy of the last frame")
        elif self._size == 0 and not self._received and command & KIND == END:  # some senders send no empty segment
            self._on_end(command, data, frame, now)
        elif len(frame.data) < 8:
            self._due = _BEHIND_A_GAP
            self._heard = max(self._heard, sequence)
            party._ignore(frame, "too short for a segment")
        elif sequence == self._due:
            self.receive(command, data, Frame(frame.can_id, data, frame.flags), now)  # more than eight bytes: the first count
        elif 1 <= sequence <= self._received and self._is_known(sequence, data):
            party._ignore(frame, "late copy of a segment")
        elif 1 <= sequence <= self._received and self.with_crc:
            self._forget_sub_block()
            party._ignore(frame, "segment out of its order")
        elif not self._received < sequence <= self._block_size or (not self._received and 0 < self._paused_behind < sequence):
            self._refuse_number(sequence, now)
        elif sequence <= self._heard:
            party._ignore(frame, "segment out of its order")
        else:
            self._due = _BEHIND_A_GAP
            self._heard = sequence
            self._paused_behind = 0
            party._last = data
            if command & FINAL or sequence == self._block_size:
                self._end_sub_block(0, now)
            else:
                party._arm(now + self._silence)

    def _forget_sub_block(self) -> None:
        """One of its segments is not where it belongs: all of them are asked for again."""
        del self._buffer[len(self._buffer) - self._received * SEGMENT_SIZE :]
        self._due = _BEHIND_A_GAP
        self._heard, self._received = self._received, 0
        self._paused_behind = 0

    def _refuse_number(self, sequence: int, now: Time) -> None:
        """It cannot be, or the sender only paused and goes on with its queue."""
        self._heard = sequence
        self._party._fail(AbortCode.INVALID_SEQUENCE_NUMBER, AbortOrigin.LOCAL, now)

    def _is_known(self, sequence: int, data: bytes) -> bool:
        """Whether the segment was received with these data, in this sub-block."""
        offset = len(self._buffer) - (self._received - sequence + 1) * SEGMENT_SIZE
        return self._buffer[offset : offset + SEGMENT_SIZE] == data[1:]

    def _end_sub_block(self, is_final: int, now: Time, is_early: bool = False) -> None:
        """Acknowledge what came in order, as soon as it may be. is_early: after a silence, not after the last segment."""
        party = self._party
        if is_early:
            self._was_silent = True
            self._paused_behind = max(self._received, self._heard)
        elif self._received:
            self._was_silent = False
            self._paused_behind = 0
        self._stalls = 0 if self._received else self._stalls + 1
        excess = self.offset + len(self._buffer) - SEGMENT_SIZE - self._limit
        if excess > 0:
            code = AbortCode.OUT_OF_MEMORY if self._size is None else AbortCode.LENGTH_TOO_HIGH
            party._fail(code, AbortOrigin.LOCAL, now)
        elif is_final:
            self._acknowledge()
            self._state = _ENDING
            self._due = MAX_BLOCK_SIZE + 1
            party._arm(now + self._silence)
        elif self._stalls > MAX_STALLS:  # without this a transfer might never end
            party._fail(AbortCode.TIMED_OUT, AbortOrigin.LOCAL, now)
        elif self._is_stream and self._received:
            self._check(len(self._buffer))
            self._state = HELD
            self._due = MAX_BLOCK_SIZE + 1
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
        self._listen(now)

    def _acknowledge(self) -> None:
        """7.2.4.3.10 and 7.2.4.3.14"""
        received = self._received
        self._last_said = ACKNOWLEDGE.pack(ACKNOWLEDGEMENT, received, self._choose_block_size())
        self._party._send(self._last_said)

    def _remind(self) -> None:
        """Say once more what may have been lost, where CRC and size guard the whole."""
        if not self.with_crc or self._size is None:
            return
        remaining = self._size - self.offset - len(self._buffer)
        if self._state == _RECEIVING and remaining <= SEGMENT_SIZE:
            self._party._send(ACKNOWLEDGE.pack(ACKNOWLEDGEMENT, 0, self._block_size))  # the only segment that is due
        elif self._last_said:
            self._party._send(self._last_said)

    def _check(self, end: int) -> None:
        """Take the buffer's bytes into the CRC, up to `end`."""
        if self.with_crc:
            self._crc = crc_hqx(self._buffer[self._checked : end], self._crc)
            self._checked = end

    def _on_end(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        """7.2.4.3.11 and 7.2.4.3.15. False if it is no end frame.

        The final segment may look like one (0xC1 is the end, and number 65): then it is the end only if it is right as such.
        """
        end = max(0, len(self._buffer) - (command >> 2 & 7))
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
