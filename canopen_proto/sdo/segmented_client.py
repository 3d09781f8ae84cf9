"""The client of an expedited or segmented transfer. CiA 301 v4.2.0, 7.2.4.3.2 to 7.2.4.3.7.

Upload     INITIATED   response 010x nn1s: the value      -> OVER       010x xx0s: ask for the first segment -> SEGMENTS
           SEGMENTS    a segment: ask for the next one    -> SEGMENTS   the last one                         -> OVER
Download   INITIATED   response 011x: it was expedited    -> OVER       else: send the first segment         -> SEGMENTS
           SEGMENTS    acknowledgement: send the next one -> SEGMENTS   of the last one                      -> OVER
"""

from __future__ import annotations

import struct
from typing import Final

from canopen_proto.abort import AbortCode
from canopen_proto.frame import Frame
from canopen_proto.machine import LocalProtocolError, RequestId, Time
from canopen_proto.sdo.block import MAX_SIZE
from canopen_proto.sdo.codec import (
    ABORT,
    DOWNLOAD_SEGMENT_RESPONSE,
    EXPEDITED_BIT,
    EXPEDITED_BITS,
    HEADS,
    INITIATE_DOWNLOAD,
    INITIATE_DOWNLOAD_RESPONSE,
    INITIATE_UPLOAD,
    INITIATE_UPLOAD_RESPONSE,
    MAX_EXPEDITED,
    SIZE,
    SIZE_BIT,
    SPECIFIER,
    TOGGLE,
    UPLOAD_SEGMENT_RESPONSE,
    pack_expedited,
    pack_initiate,
    segment,
)
from canopen_proto.sdo.events import SdoDownloaded, SdoUploaded
from canopen_proto.sdo.segmented import SegmentedTransfer, SegmentReceiver
from canopen_proto.sdo.transfer import INITIATED, OVER, SEGMENTS, UNKNOWN_SIZE, Buffer, ChannelEnd, Transfer

NOBODY: Final[RequestId] = 0
"""The request that a `Question` belongs to: its outcome is not reported."""


class Upload(SegmentReceiver):
    """Read an object, expedited or in segments, as the server chooses."""

    __slots__ = ("_most",)

    def __init__(self, end: ChannelEnd, index: int, subindex: int, most: int) -> None:
        """index 0..0xFFFF, subindex 0..0xFF; else LocalProtocolError. most: bytes that are accepted."""
        try:
            first = pack_initiate(INITIATE_UPLOAD, index, subindex, 0)
        except struct.error:
            raise impossible("upload", index, subindex) from None
        Transfer.__init__(self, end, index, subindex, first)
        self._most = most

    def again(self) -> Transfer:
        return Upload(self.end, self.index, self.subindex, self._most)

    def _on_answer(self, command: int, data: bytes, now: Time) -> bool:
        """The server answers with the value, or with its size and segments to come. 7.2.4.3.6"""
        if command & SPECIFIER != INITIATE_UPLOAD_RESPONSE or data[1:4] != self.name:
            return False
        end = self.end
        end.last = data
        self.is_answered = True
        if command & EXPEDITED_BIT:
            unused = command >> 2 & 3 if command & SIZE_BIT else 0
            end.out.events.append(SdoUploaded(end.node_id, self.request_id, self.index, self.subindex, data[4 : 8 - unused]))
            self.state = OVER
            return True
        size: int = SIZE.unpack_from(data, 4)[0] if command & SIZE_BIT else UNKNOWN_SIZE
        if size > self._most:
            self.abort(AbortCode.OUT_OF_MEMORY)
        else:
            self._start(UPLOAD_SEGMENT_RESPONSE, size, self._most, MAX_SIZE, end.replies[1], now)
        return True

    def _complete(self, content: bytes, reply: Frame, now: Time) -> None:
        end = self.end
        end.out.events.append(SdoUploaded(end.node_id, self.request_id, self.index, self.subindex, content))
        self.state = OVER


def question_about(index: int) -> bytes:
    """Return the initiate frame of a question about an object: it reads its sub 0."""
    return pack_initiate(INITIATE_UPLOAD, index, 0, 0)


class Question(Transfer):
    """Read an object whose value nobody wants, before a request in doubt: see client.py. It has no outcome.

    A client asks one question for each write that is repeated, so it keeps this object, and its frame.
    """

    __slots__ = ("frame",)

    def __init__(self, end: ChannelEnd, first: bytes) -> None:
        """first: of `question_about`."""
        super().__init__(end, first[1] | first[2] << 8, 0, first)
        self.request_id = NOBODY
        self.is_urgent = False
        self.frame = Frame(end.can_id, first, end.flags)

    def receive(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        if command & SPECIFIER != INITIATE_UPLOAD_RESPONSE or data[1:4] != self.name:
            return False
        end = self.end
        end.last = data
        self.is_answered = True
        self.state = OVER
        if not command & EXPEDITED_BIT:
            end.send(pack_initiate(ABORT, self.index, 0, AbortCode.GENERAL_ERROR))  # of the segments that the server is ready for
        return True


class Download(SegmentedTransfer):
    """Write an object: expedited if it has 1 to 4 bytes, else in segments (no bytes at all have no expedited form)."""

    __slots__ = ("_content", "_offset")

    def __init__(self, end: ChannelEnd, index: int, subindex: int, content: Buffer) -> None:
        """index 0..0xFFFF, subindex 0..0xFF; else LocalProtocolError."""
        if not isinstance(content, bytes):
            content = own(content, index, subindex)
        size = len(content)
        try:
            if 0 < size <= MAX_EXPEDITED:
                first = pack_expedited(INITIATE_DOWNLOAD | EXPEDITED_BITS[size], index, subindex, content)
            else:
                first = pack_initiate(INITIATE_DOWNLOAD | SIZE_BIT, index, subindex, size)
        except struct.error:
            raise impossible("download", index, subindex) from None
        Transfer.__init__(self, end, index, subindex, first)  # `super()` would take as long as half of it
        self._content = content
        self._offset = 0  # what has been sent

    def again(self) -> Transfer | None:
        is_one_frame = self.first[0] & EXPEDITED_BIT
        return None if is_one_frame else Download(self.end, self.index, self.subindex, self._content)

    def receive(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        end = self.end
        if self.state is SEGMENTS:  # an acknowledgement, 7.2.4.3.4
            if command & ~0x0F != self.due:
                return False
            end.last = data
            if self._offset < len(self._content):
                self._send_segment(now)
                return True
        else:  # 7.2.4.3.3
            if command & SPECIFIER != INITIATE_DOWNLOAD_RESPONSE or data[1:4] != self.name:
                return False
            end.last = data
            self.is_answered = True
            if not self.first[0] & EXPEDITED_BIT:
                self.state = SEGMENTS
                self.due = DOWNLOAD_SEGMENT_RESPONSE | TOGGLE
                self._send_segment(now)
                return True
        end.out.events.append(SdoDownloaded(end.node_id, self.request_id, self.index, self.subindex))
        self.state = OVER
        return True

    def _send_segment(self, now: Time) -> None:
        """Send the next one, with the other toggle than the last response. 7.2.4.3.4"""
        end, content, offset = self.end, self._content, self._offset
        self.due = due = self.due ^ TOGGLE
        self._offset = behind = offset + 7
        toggle = due & TOGGLE
        payload = HEADS[toggle] + content[offset:behind] if behind < len(content) else segment(toggle, content, offset)
        end.out.frames.append(Frame(end.can_id, payload, end.flags))
        self.deadline = now + (self.own_timeout or end.timeout)

    @property
    def is_all_sent(self) -> bool:
        if self.state is INITIATED:
            return bool(self.first[0] & EXPEDITED_BIT)
        return self._offset >= len(self._content)

    @property
    def delivered(self) -> int:
        return max(0, self._offset - 7)  # the last segment is under way


def own(content: Buffer, index: int, subindex: int) -> bytes:
    """Return the content as bytes, which cannot change while the request waits; else raise LocalProtocolError."""
    if not isinstance(content, bytes | bytearray | memoryview):  # bytes(6) would be six zeros
        raise LocalProtocolError(f"download {index!r}:{subindex!r}: bytes expected, not {content!r}")
    return bytes(content)  # the same object if it is bytes already


def impossible(what: str, index: object, subindex: object) -> LocalProtocolError:
    """Return the error for an index or subindex that no frame can carry. what: was to be done, for the text."""
    return LocalProtocolError(f"{what} {index!r}:{subindex!r}: index 0..0xFFFF and subindex 0..0xFF expected")
