"""The side of a block transfer that has the data: the client in a download, the server in an upload.

block.py tells how a block transfer goes.

    INITIATED   the receiver says that it is ready -> SEGMENTS (the sub-block goes out in bursts), or HELD if it is not all there
    SEGMENTS    all of the sub-block went out -> SENT
    SENT        acknowledgement -> SEGMENTS with the next sub-block, or HELD; of the last segment: send the end -> ENDING
    HELD        the user feeds the rest of a sub-block -> SEGMENTS
    ENDING      end response -> OVER

An acknowledgement says: "the segments up to ackseq came in order; send so many of what follows in one sub-block". It may come
before all of the sub-block was sent: some receivers complain of a gap at once. A sub-block begins only when all of it is there,
so a stream that is fed slowly never stops inside one. Acknowledged bytes go into the CRC and leave a stream's buffer; the others
are held, and sent again if the receiver asks for them.

Source: CiA 301 v4.2.0, 7.2.4.3.9 to 7.2.4.3.11 (download), 7.2.4.3.13 to 7.2.4.3.16 (upload, CRC).
"""

from __future__ import annotations

from binascii import crc_hqx
from typing import ClassVar, Final

from canopen_proto.abort import AbortCode
from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_proto.sdo.block import END_FRAME, MAX_BLOCK_SIZE, MAX_STALLS, SEGMENT_SIZE
from canopen_proto.sdo.codec import ACKNOWLEDGEMENT, END, END_RESPONSE, FINAL, HEADS, KIND
from canopen_proto.sdo.transfer import ENDING, HELD, INITIATED, OVER, SEGMENTS, SENT, Buffer, ChannelEnd, Transfer


class BlockSender(Transfer):
    """See this module's text. Subclasses say what follows from what, by the methods at the end."""

    __slots__ = (
        "_acknowledged", "_base", "_block_size", "_content", "_count", "_crc", "_is_final", "_is_whole", "_sent", "_stalls",
        "_unused", "_with_crc",
    )  # fmt: skip

    in_blocks: ClassVar[bool] = True

    def __init__(
        self, end: ChannelEnd, index: int, subindex: int, first: bytes, content: bytes | bytearray, is_whole: bool, with_crc: bool
    ) -> None:
        """content: all of it, or, if it is fed piece by piece (is_whole = False), a bytearray that `feed` adds to."""
        super().__init__(end, index, subindex, first)
        self._content = content
        self._is_whole = is_whole
        self._with_crc = with_crc
        self._crc = 0  # of what was acknowledged
        self._acknowledged = 0  # bytes
        self._base = 0  # where the sub-block begins in content
        self._count = 0  # its segments
        self._sent = 0  # of these
        self._is_final = False  # it is the last one
        self._unused = 0  # bytes of its last segment
        self._block_size = 0
        self._stalls = 0

    @property
    def is_all_sent(self) -> bool:
        """Whether all segments have been sent, as far as we know: the receiver may have everything."""
        return self._is_final and self._sent == self._count

    @property
    def delivered(self) -> int:
        return self._acknowledged

    # ---- inputs ----

    def receive(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        if self.state is INITIATED:
            return self._on_answer(command, data, frame, now)
        handler = _HANDLERS.get((self.state, command & KIND))
        if handler is not None:
            handler(self, data, frame, now)
        return handler is not None

    def handle_timeout(self, now: Time) -> None:
        if self.state is SEGMENTS:
            self._transmit(now)
        else:
            super().handle_timeout(now)

    def feed(self, piece: Buffer, last: bool, now: Time) -> None:
        assert isinstance(self._content, bytearray)
        self._content += piece
        self._is_whole = last
        if self.state is HELD:
            self._begin_sub_block(now)

    # ---- the transfer ----

    def _start(self, block_size: int, now: Time) -> None:
        """The receiver is ready, and asks for sub-blocks of this length."""
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            self.abort(AbortCode.INVALID_BLOCK_SIZE)
            return
        self._block_size = block_size
        self._begin_sub_block(now)

    def _begin_sub_block(self, now: Time) -> None:
        remaining = len(self._content) - self._base
        most = self._block_size * SEGMENT_SIZE
        if not self._is_whole and remaining < 2 * most:
            self._ask_for_more()
        self._sent = 0
        if remaining > most:
            self._count = self._block_size
            self._is_final = False
        elif self._is_whole:
            self._count = count = -(-remaining // SEGMENT_SIZE) or 1  # no data at all is one segment of which nothing is used
            self._unused = count * SEGMENT_SIZE - remaining
            self._is_final = True
        else:
            self.state = HELD
            self.deadline = now + self.end.stream_timeout
            return
        self.state = SEGMENTS
        self.deadline = now + self.end.copy_guard

    def _transmit(self, now: Time) -> None:
        """Send segments of the sub-block, as many as go out in one turn."""
        end = self.end
        can_id, flags, frames = end.can_id, end.flags, end.out.frames
        sent, count = self._sent, self._count
        goal = min(sent + end.max_burst, count)
        ends_all = self._is_final and goal == count
        begin = self._base + sent * SEGMENT_SIZE
        burst = bytes(self._content[begin : begin + (goal - sent) * SEGMENT_SIZE])
        offset = 0
        for head in HEADS[sent + 1 : goal if ends_all else goal + 1]:
            behind = offset + SEGMENT_SIZE
            frames.append(Frame(can_id, head + burst[offset:behind], flags))
            offset = behind
        if ends_all:
            payload = bytes((FINAL | goal,)) + burst[offset:] + bytes(self._unused)
            frames.append(Frame(can_id, payload, flags))
        self._sent = goal
        if goal < count:
            self.deadline = now + end.burst_interval
        else:
            self.state = SENT
            self.deadline = now + self.patience

    def _on_acknowledgement(self, data: bytes, frame: Frame, now: Time) -> None:
        """7.2.4.3.10 and 7.2.4.3.14"""
        end = self.end
        acknowledged, block_size = data[1], data[2]
        if acknowledged > self._sent and (acknowledged > MAX_BLOCK_SIZE or (self._sent and data != end.last)):
            self.abort(AbortCode.INVALID_SEQUENCE_NUMBER)
            return
        if not self._sent or acknowledged > self._sent:
            end.ignore(frame, "second copy of an acknowledgement: nothing was sent since")
            return
        end.last = data
        is_end = self._is_final and acknowledged == self._count
        if not is_end and not 1 <= block_size <= MAX_BLOCK_SIZE:
            self.abort(AbortCode.INVALID_BLOCK_SIZE)
            return
        self._stalls = 0 if acknowledged else self._stalls + 1
        if self._stalls > MAX_STALLS:  # without this a transfer might never end
            self.abort(AbortCode.TIMED_OUT)
            return
        self._drop(acknowledged * SEGMENT_SIZE)
        if is_end:
            self.state = ENDING
            end.send(END_FRAME.pack(END | self._unused << 2, self._crc))
            self.deadline = now + self.patience
            return
        self._block_size = block_size
        self._begin_sub_block(now)

    def _drop(self, size: int) -> None:
        """Forget so many bytes of the content: they have arrived."""
        end = self._base + size
        self._acknowledged += size
        if self._with_crc:
            self._crc = crc_hqx(self._content[self._base : end], self._crc)
        if isinstance(self._content, bytearray):
            del self._content[:end]
        else:
            self._base = end

    def _on_end_response(self, data: bytes, frame: Frame, now: Time) -> None:
        """7.2.4.3.11 and 7.2.4.3.15"""
        self.end.last = data
        self._report_success()
        self.state = OVER

    # ---- what subclasses say ----

    def _on_answer(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        """Take a frame while the receiver has not said that it is ready. False if it does not say that."""
        raise NotImplementedError

    def _ask_for_more(self) -> None:
        """Less than two sub-blocks are left of a stream."""

    def _report_success(self) -> None:
        """The receiver has confirmed the whole transfer."""


_HANDLERS: Final = {
    (SEGMENTS, ACKNOWLEDGEMENT): BlockSender._on_acknowledgement,
    (SENT, ACKNOWLEDGEMENT): BlockSender._on_acknowledgement,
    (HELD, ACKNOWLEDGEMENT): BlockSender._on_acknowledgement,
    (ENDING, END_RESPONSE): BlockSender._on_end_response,
}
"""The frames that are due in each state, once the transfer has begun."""
