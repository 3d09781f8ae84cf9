"""The side of a block transfer that has the data: the client in a download, the server in an upload.

block.py tells how a block transfer goes. A sub-block is begun once all of it is there, so that a stream which is fed slowly never
stands in the middle of one. What has been acknowledged goes into the CRC, and is dropped from a stream's buffer; what has not is
held, and sent again where the receiver asks for it.

An acknowledgement is taken as: "in order came the segments up to ackseq; of what follows send so many in one sub-block". It may
come before all of the sub-block is sent: some receivers complain of a gap at once.

Source: CiA 301 v4.2.0, 7.2.4.3.9 to 7.2.4.3.11 (download), 7.2.4.3.13 to 7.2.4.3.16 (upload, CRC).
"""

from __future__ import annotations

from binascii import crc_hqx
from typing import Final

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_proto.sdo.block import (
    ACKNOWLEDGEMENT,
    END,
    END_FRAME,
    END_RESPONSE,
    FINAL,
    HEADS,
    KIND,
    MAX_BLOCK_SIZE,
    MAX_STALLS,
    SEGMENT_SIZE,
    Party,
    silence_limit,
)

# States
STARTING: Final = 0  # the receiver has not said that it is ready
_SENDING: Final = 1
_SENT: Final = 2  # all of the sub-block; the acknowledgement is due
_STARVED: Final = 3  # the next sub-block is not all there
_ENDING: Final = 4  # the end response is due


class BlockSender:
    """See this module's text. Subclasses say what follows from what, by the methods at the end."""

    __slots__ = (
        "_base", "_block_size", "_content", "_count", "_crc", "_is_final", "_is_whole", "_party", "_patience", "_sent", "_stalls",
        "_state", "_unused", "with_crc",
    )  # fmt: skip

    def __init__(self, party: Party, content: bytes | bytearray, is_whole: bool, with_crc: bool) -> None:
        """content: all of it, or, where it is fed piece by piece (is_whole = False), a bytearray that `extend` adds to."""
        self._party = party
        self._patience = 2 * silence_limit(party.timeout)  # a receiver asks again after one silence
        self._content = content
        self._is_whole = is_whole
        self.with_crc = with_crc
        self._crc = 0  # of what was acknowledged
        self._base = 0  # where the sub-block begins in content
        self._count = 0  # its segments
        self._sent = 0  # of these
        self._is_final = False  # it is the last one
        self._unused = 0  # bytes of its last segment
        self._block_size = 0
        self._stalls = 0
        self._state = STARTING

    @property
    def has_begun(self) -> bool:
        """Whether the initiation is over."""
        return self._state != STARTING

    @property
    def is_all_sent(self) -> bool:
        """Whether all segments have been sent, as far as we know: the receiver may have everything."""
        return self._is_final and self._sent == self._count

    def extend(self, piece: bytes | bytearray | memoryview, is_whole: bool, now: Time) -> None:
        """More of the content; is_whole: this was the last."""
        assert isinstance(self._content, bytearray)
        self._content += piece
        self._is_whole = is_whole
        if self._state == _STARVED:
            self._begin_sub_block(now)

    # ---- inputs ----

    def receive(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        kind = command & KIND
        if kind == ACKNOWLEDGEMENT and _SENDING <= self._state <= _STARVED:
            self._on_acknowledgement(data, frame, now)
        elif kind == END_RESPONSE and self._state == _ENDING:
            self._party._last = data
            self._ended(now)
        else:
            self._on_other(command, data, frame, now)

    def handle_timeout(self, now: Time) -> None:
        if self._state == _SENDING:
            self._transmit(now)
        elif self._state == _STARVED:
            self._party._fail(AbortCode.CANNOT_TRANSFER, AbortOrigin.TIMEOUT, now)
        else:
            self._party._fail(AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT, now)

    # ---- the transfer ----

    def _start(self, block_size: int, now: Time) -> None:
        """The receiver is ready, and asks for sub-blocks of this length."""
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            self._party._fail(AbortCode.INVALID_BLOCK_SIZE, AbortOrigin.LOCAL, now)
            return
        self._block_size = block_size
        self._begin_sub_block(now)

    def _begin_sub_block(self, now: Time) -> None:
        party = self._party
        remaining = len(self._content) - self._base
        most = self._block_size * SEGMENT_SIZE
        if not self._is_whole and remaining < 2 * most:
            self._wants_more()
        self._sent = 0
        if remaining > most:
            self._count = self._block_size
            self._is_final = False
        elif self._is_whole:
            self._count = count = -(-remaining // SEGMENT_SIZE) or 1  # no data at all is one segment of which nothing is used
            self._unused = count * SEGMENT_SIZE - remaining
            self._is_final = True
        else:
            self._state = _STARVED
            party._arm(now + party.stream_timeout)
            return
        self._state = _SENDING
        party._arm(now + party.copy_guard)

    def _transmit(self, now: Time) -> None:
        """Send segments of the sub-block, as many as go out in one turn."""
        party = self._party
        content = self._content
        sent, count = self._sent, self._count
        end = min(sent + party.max_burst, count)
        ends_all = self._is_final and end == count
        offset = self._base + sent * SEGMENT_SIZE
        can_id, flags, frames = party._send_can_id, party._send_flags, party.out.frames
        for sequence in range(sent + 1, end if ends_all else end + 1):
            frames.append(Frame(can_id, HEADS[sequence] + content[offset : offset + 7], flags, 8))
            offset += 7
        if ends_all:
            payload = bytes((FINAL | end,)) + content[offset : offset + 7] + bytes(self._unused)
            frames.append(Frame(can_id, payload, flags, 8))
        self._sent = end
        if end < count:
            party._arm(now + party.burst_interval)
        else:
            self._state = _SENT
            party._arm(now + self._patience)

    def _on_acknowledgement(self, data: bytes, frame: Frame, now: Time) -> None:
        """7.2.4.3.10 and 7.2.4.3.14"""
        party = self._party
        acknowledged, block_size = data[1], data[2]
        if acknowledged > self._sent and (acknowledged > MAX_BLOCK_SIZE or (self._sent and data != party._last)):
            party._fail(AbortCode.INVALID_SEQUENCE_NUMBER, AbortOrigin.LOCAL, now)
            return
        if not self._sent or acknowledged > self._sent:
            party._ignore(frame, "second copy of an acknowledgement: nothing was sent since")
            return
        party._last = data
        is_end = self._is_final and acknowledged == self._count
        if not is_end and not 1 <= block_size <= MAX_BLOCK_SIZE:
            party._fail(AbortCode.INVALID_BLOCK_SIZE, AbortOrigin.LOCAL, now)
            return
        self._stalls = 0 if acknowledged else self._stalls + 1
        if self._stalls > MAX_STALLS:  # without this a transfer might never end
            party._fail(AbortCode.TIMED_OUT, AbortOrigin.LOCAL, now)
            return
        self._drop(acknowledged * SEGMENT_SIZE)
        if is_end:
            self._state = _ENDING
            party._send(END_FRAME.pack(END | self._unused << 2, self._crc))
            party._arm(now + self._patience)
            return
        self._block_size = block_size
        self._begin_sub_block(now)

    def _drop(self, size: int) -> None:
        """These bytes have arrived."""
        end = self._base + size
        if self.with_crc:
            self._crc = crc_hqx(self._content[self._base : end], self._crc)
        if isinstance(self._content, bytearray):
            del self._content[:end]
        else:
            self._base = end

    # ---- what subclasses say ----

    def _wants_more(self) -> None:
        """Less than two sub-blocks are left of a stream."""

    def _ended(self, now: Time) -> None:
        """The receiver has confirmed the whole transfer."""
        raise NotImplementedError

    def _on_other(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """A frame that is neither an acknowledgement nor an end response that is due."""
        raise NotImplementedError
