"""The side of a block transfer that gets the data: the server in a download, the client in an upload.

block.py tells how a block transfer goes.

    INITIATED   the sender says that it is ready -> SEGMENTS (only a client waits for that)
    SEGMENTS    the end of a sub-block: acknowledge it -> SEGMENTS, or, of the final one, -> ENDING
                a sub-block of a stream: hand it over -> HELD
    HELD        the user has taken the piece: acknowledge the sub-block -> SEGMENTS
    ENDING      end frame: check CRC and size, send the end response -> OVER

Within a sub-block every frame but an abort (0x80) is a segment, whatever else its first byte might mean: the sequence number
decides. Segments are taken in order only. What is acknowledged, and when:

    the last segment of the sub-block came          those in order, at once; not before that, even if one is missing
    silence, and some segment came                  those in order: the end of the sub-block was lost, or the sender pauses
    silence, and none came                          our last frame again, if CRC and size guard the transfer. If only one
                                                    segment is due, we ask for that segment
    a second silence                                the transfer is aborted

A silence lasts `silence_limit`. It is the second one if no segment came in order since the first. A sender that only paused goes
on with the numbers of its sub-block; one whose last segments were lost begins with 1. So if the next number is higher than all
before the early acknowledgement, the transfer ends: the bytes can't be wrong, even without CRC. That is also so while the
acknowledgement waits for a piece to be taken. Once number 1 has come, nothing of the old sub-block can follow. If nothing came
before the silence, there is no such sign, and a sender that only pauses may take our repetition for the next acknowledgement:
CRC and size have to guard it.

On CAN the numbers of a sub-block only rise. A number that was received already, with other data, shows a frame out of its order:
one of the two is of another sub-block. With a CRC the whole sub-block is asked for again; without one the transfer is aborted.
Between two sub-blocks, and when all have come, segments with numbers that no request has, and those that follow them, are late,
or their sender is a sub-block ahead: they are not acted on. A segment of less than eight bytes counts as lost.

A transfer is right if the CRC is (if both sides support it) and the size is (if it was announced). The CRC begins with 0, so
zeros at the beginning of the data do not count in it: while it is 0 it guards nothing, unless the size is known too.

In a stream each sub-block is a piece. It is handed over before it is acknowledged, and the acknowledgement waits until the user
has taken it. Only the end frame tells what the final sub-block holds, so that one is handed over at the end.

Source: CiA 301 v4.2.0, 7.2.4.3.9 to 7.2.4.3.11 (download), 7.2.4.3.13 to 7.2.4.3.16 (upload, CRC).
"""

from __future__ import annotations

from binascii import crc_hqx
from typing import ClassVar, Final

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_proto.sdo.block import (
    ACKNOWLEDGE,
    FRAME_SIZE,
    MAX_BLOCK_SIZE,
    MAX_STALLS,
    SEGMENT_SIZE,
    chosen_block_size,
    is_next,
    next_number,
    silence_limit,
)
from canopen_proto.sdo.codec import ABORT, ACKNOWLEDGEMENT, END, FINAL, KIND, SEQUENCE
from canopen_proto.sdo.transfer import ENDING, HELD, INITIATED, OVER, SEGMENTS, ChannelEnd, Transfer

_BEHIND_A_GAP: Final = -1
"""The number that is due then: none is taken before the sub-block is over."""


class BlockReceiver(Transfer):
    """See this module's text. Subclasses say what follows from what, by the methods at the end."""

    __slots__ = (
        "_block_size", "_buffer", "_checked", "_crc", "_due", "_heard", "_is_stream", "_last_said", "_limit", "_paused_behind",
        "_received", "_silence", "_size", "_stalls", "_sub_block", "_was_silent", "_with_crc", "offset",
    )  # fmt: skip

    in_blocks: ClassVar[bool] = True

    _silence: Time  # from `_start` on: how long no segment may come, in ns

    def __init__(self, end: ChannelEnd, index: int, subindex: int, first: bytes, is_stream: bool) -> None:
        super().__init__(end, index, subindex, first)
        self._is_stream = is_stream
        self._with_crc = False
        self._crc = 0
        self._checked = 0  # bytes of _buffer that are in the CRC
        self._buffer = bytearray()  # what came in order in the sub-blocks before, and was not handed on
        self._sub_block = bytearray()  # the frames of this one that came in order, whole: without a copy of each one's data
        self.offset = 0  # of _buffer in the whole: what was handed on
        self._size: int | None = None  # announced
        self._limit = 0  # of the whole
        self._block_size = 0
        self._received = 0  # segments of this sub-block, in order
        self._due = 1  # the number that is taken next
        self._heard = 0  # the highest number behind the gap
        self._paused_behind = 0  # the highest number before an early acknowledgement; 0: there was none
        self._was_silent = False  # for as long as _silence, since the last segment in order
        self._stalls = 0  # acknowledgements of nothing, one behind the other
        self._last_said = b""  # what to repeat if it may have been lost

    @property
    def straggler(self) -> int:
        """If the transfer ends now: the number of the segment that may be next in the sender's queue.

        Above MAX_BLOCK_SIZE: the sub-block is over, but the sender may have begun another.
        """
        if self.state is OVER:
            return 0  # all of it came
        if self.state is not SEGMENTS and not self._paused_behind:
            return self._due
        heard = max(self._received, self._heard) or self._paused_behind
        return heard + 1 if heard < self._block_size else MAX_BLOCK_SIZE + 1

    # ---- inputs ----

    def receive(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        sequence = command & SEQUENCE
        if sequence != self._due or self.state is not SEGMENTS or data is not frame.data:
            if self.state is not SEGMENTS or command == ABORT:
                return self._on_no_segment(command, data, frame, now)
            return self._on_gap(command, sequence, data, frame, now)
        sub_block = self._sub_block
        sub_block += data
        self._received = sequence
        self._due = sequence + 1
        self.end.last = data
        if command >= self._block_size:  # the last one of a sub-block, or of all: FINAL is above all numbers
            self._end_sub_block(command & FINAL, now)
        else:
            self.deadline = now + self._silence
        return True

    def _on_no_segment(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        """No segment is due, or it is an abort."""
        state = self.state
        if state is INITIATED:
            return self._on_answer(command, data, frame, now)
        if state is ENDING and command & KIND == END and self._on_end(command, data, frame, now):
            return True
        sequence = command & SEQUENCE
        if data == self.end.last:
            self.end.ignore(frame, "second copy of the last frame")
        elif state is HELD and 0 < self._paused_behind < sequence <= self._block_size:
            self._refuse_number(sequence)
        elif state is not SEGMENTS and is_next(command, self._due):
            self._due = next_number(command)
            self.end.ignore(frame, "segment out of its order")
        else:
            return False
        return True

    def handle_timeout(self, now: Time) -> None:
        if self.state is HELD or self.state is INITIATED:
            super().handle_timeout(now)
        elif self.state is SEGMENTS and (self._received or (self._heard and not self._was_silent)):
            self._end_sub_block(0, now, is_early=True)
        elif self._was_silent:
            self.abort(AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT)
        else:
            self._was_silent = True
            self._remind()
            self.deadline = now + self._silence

    # ---- the transfer ----

    def _start(self, size: int | None, limit: int, with_crc: bool, now: Time) -> None:
        """The segments will come now. size: as announced. limit: of the whole, in bytes. The block size has been told already."""
        self._size = size
        self._limit = limit if size is None else size
        self._with_crc = with_crc
        self._silence = silence_limit(self.timeout)
        self._listen(now)

    def _listen(self, now: Time) -> None:
        """Wait for the first segment of a sub-block."""
        self.state = SEGMENTS
        self._received = 0
        self._due = 1
        self._heard = 0
        self.deadline = now + self._silence

    def _choose_block_size(self) -> int:
        """Choose how long the next sub-block may be."""
        self._block_size = chosen_block_size(self.end.block_size)
        return self._block_size

    def _on_gap(self, command: int, sequence: int, data: bytes, frame: Frame, now: Time) -> bool:
        """Take a frame that is not the segment that is due."""
        end = self.end
        if data == end.last:
            end.ignore(frame, "second copy of the last frame")
        elif self._size == 0 and not self._received and command & KIND == END:  # some senders send no empty segment
            self._on_end(command, data, frame, now)
        elif len(frame.data) < 8:
            self._due = _BEHIND_A_GAP
            self._heard = max(self._heard, sequence)
            end.ignore(frame, "too short for a segment")
        elif sequence == self._due:
            self.receive(command, data, Frame(frame.can_id, data, frame.flags), now)  # more than eight bytes: the first count
        elif 1 <= sequence <= self._received and self._is_known(sequence, data):
            end.ignore(frame, "late copy of a segment")
        elif 1 <= sequence <= self._received and self._with_crc:
            self._forget_sub_block()
            end.ignore(frame, "segment out of its order")
        elif not self._received < sequence <= self._block_size or (not self._received and 0 < self._paused_behind < sequence):
            self._refuse_number(sequence)
        elif sequence <= self._heard:
            end.ignore(frame, "segment out of its order")
        else:
            self._due = _BEHIND_A_GAP
            self._heard = sequence
            self._paused_behind = 0
            end.last = data
            if command & FINAL or sequence == self._block_size:
                self._end_sub_block(0, now)
            else:
                self.deadline = now + self._silence
        return True

    def _forget_sub_block(self) -> None:
        """Ask for the whole sub-block again: one of its segments is not where it belongs."""
        self._sub_block.clear()
        self._due = _BEHIND_A_GAP
        self._heard, self._received = self._received, 0
        self._paused_behind = 0

    def _refuse_number(self, sequence: int) -> None:
        """Abort: no segment can have this number, or the sender only paused and goes on with its queue."""
        self._heard = sequence
        self.abort(AbortCode.INVALID_SEQUENCE_NUMBER)

    def _is_known(self, sequence: int, data: bytes) -> bool:
        """Whether the segment was received with these data, in this sub-block."""
        end = sequence * FRAME_SIZE
        return self._sub_block[end - SEGMENT_SIZE : end] == data[1:]

    def _end_sub_block(self, is_final: int, now: Time, is_early: bool = False) -> None:
        """Acknowledge what came in order, as soon as it may be. is_early: after a silence, not after the last segment."""
        del self._sub_block[::FRAME_SIZE]  # the first byte of each frame
        self._buffer += self._sub_block
        self._sub_block.clear()
        if is_early:
            self._was_silent = True
            self._paused_behind = max(self._received, self._heard)
        elif self._received:
            self._was_silent = False
            self._paused_behind = 0
        self._stalls = 0 if self._received else self._stalls + 1
        excess = self.offset + len(self._buffer) - SEGMENT_SIZE - self._limit
        if excess > 0:
            self.abort(AbortCode.OUT_OF_MEMORY if self._size is None else AbortCode.LENGTH_TOO_HIGH)
        elif is_final:
            self._acknowledge()
            self.state = ENDING
            self._due = MAX_BLOCK_SIZE + 1
            self.deadline = now + self._silence
        elif self._stalls > MAX_STALLS:  # without this a transfer might never end
            self.abort(AbortCode.TIMED_OUT)
        elif self._is_stream and self._received:
            self._check(len(self._buffer))
            self.state = HELD
            self._due = MAX_BLOCK_SIZE + 1
            self.deadline = now + self.end.stream_timeout
            piece, self._buffer, self._checked = bytes(self._buffer), bytearray(), 0
            offset, self.offset = self.offset, self.offset + len(piece)
            self._hand_over(piece, offset)
        else:
            self._check(len(self._buffer))
            self._acknowledge()
            self._listen(now)

    def proceed(self, now: Time) -> bool:
        if self.state is HELD:
            self._acknowledge()
            self._listen(now)
        return True

    def _acknowledge(self) -> None:
        """7.2.4.3.10 and 7.2.4.3.14"""
        received = self._received
        self._last_said = ACKNOWLEDGE.pack(ACKNOWLEDGEMENT, received, self._choose_block_size())
        self.end.send(self._last_said)

    def _remind(self) -> None:
        """Send the frame again that may have been lost, if CRC and size guard the whole."""
        if not self._with_crc or self._size is None:
            return
        remaining = self._size - self.offset - len(self._buffer)
        if self.state is SEGMENTS and remaining <= SEGMENT_SIZE:
            self.end.send(ACKNOWLEDGE.pack(ACKNOWLEDGEMENT, 0, self._block_size))  # the only segment that is due
        elif self._last_said:
            self.end.send(self._last_said)

    def _check(self, end: int) -> None:
        """Take the buffer's bytes into the CRC, up to `end`."""
        if self._with_crc:
            self._crc = crc_hqx(self._buffer[self._checked : end], self._crc)
            self._checked = end

    def _on_end(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        """Check the transfer by its end frame, 7.2.4.3.11 and 7.2.4.3.15. False if it is no end frame.

        The final segment may look like one (0xC1 is the end, and number 65): a copy of it is the end only if CRC and size agree.
        """
        end = max(0, len(self._buffer) - (command >> 2 & 7))
        is_doubtful = data == self.end.last
        if is_doubtful and not self._with_crc and self._size is None:
            return False
        crc = crc_hqx(self._buffer[self._checked : end], self._crc)
        if self._with_crc and crc != data[1] | data[2] << 8:
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
            self.abort(fault)
            return True
        self.end.last = data
        del self._buffer[end:]
        self._complete(bytes(self._buffer), now)
        return True

    # ---- what subclasses say ----

    def _on_answer(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        """Take a frame while the sender has not said that it is ready. False if it does not say that."""
        return False

    def _hand_over(self, piece: bytes, offset: int) -> None:
        """Give a piece of a stream to the user; `proceed` once it was taken."""
        raise NotImplementedError

    def _complete(self, content: bytes, now: Time) -> None:
        """All of it came (of a stream: the last piece, from `offset` on), and is right; the end response is due."""
        raise NotImplementedError
