"""The server of an expedited or segmented transfer. CiA 301 v4.2.0, 7.2.4.3.2 to 7.2.4.3.7.

    ReadAccess       HELD       the host gives the object: answer the client -> OVER, and another transfer may go on
    ServerUpload     SEGMENTS   request: send the segment -> SEGMENTS; the last one -> OVER
                                the host has not given that segment yet -> HELD
                     HELD       the host gives the next piece -> SEGMENTS
    ServerDownload   SEGMENTS   a segment: acknowledge it -> SEGMENTS; the last one: write the object -> OVER
                                a piece for the host is complete -> HELD
                     HELD       the host has taken the piece: acknowledge its last segment -> SEGMENTS

Expedited transfers are answered at once.
"""

from __future__ import annotations

from typing import ClassVar

from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_proto.sdo.block import MAX_SIZE, SUB_BLOCK_SIZE
from canopen_proto.sdo.block_server import ServerBlockUpload
from canopen_proto.sdo.codec import (
    BLOCK_UPLOAD,
    DOWNLOAD_SEGMENT,
    EXPEDITED_BITS,
    HEADS,
    INITIATE_DOWNLOAD_RESPONSE,
    INITIATE_UPLOAD_RESPONSE,
    MAX_EXPEDITED,
    SIZE_BIT,
    TOGGLE,
    UPLOAD_SEGMENT,
    pack_expedited,
    pack_initiate,
    segment,
)
from canopen_proto.sdo.host import Door
from canopen_proto.sdo.segmented import SegmentedTransfer, SegmentReceiver
from canopen_proto.sdo.transfer import HELD, OVER, SEGMENTS, UNKNOWN_SIZE, Buffer, ChannelEnd, Transfer


def answer_upload(
    end: ChannelEnd, index: int, subindex: int, first: bytes, door: Door, content: bytes, more: bool, now: Time
) -> Transfer | None:
    """Answer an upload's initiate request, `first`; return the transfer that goes on, or None if nothing has to follow.

    more: content is the first piece that the host gives. 7.2.4.3.6 and, if blocks were asked for, 7.2.4.3.13; the client's pst
    (byte 5) may allow a normal upload of a small object instead.
    """
    size = len(content)
    if first[0] >= BLOCK_UPLOAD and (more or not 0 < first[5] >= size):
        return ServerBlockUpload(end, index, subindex, first, door, content, more, now)
    if 0 < size <= MAX_EXPEDITED and not more:
        payload = pack_expedited(INITIATE_UPLOAD_RESPONSE | EXPEDITED_BITS[size], index, subindex, content)
        end.out.frames.append(Frame(end.can_id, payload, end.flags))
        return None
    return ServerUpload(end, index, subindex, first, door, content, more, now)


class ReadAccess(Transfer):
    """The host is to give the object that the client wants to read."""

    __slots__ = ("_door",)

    is_with_host: ClassVar[bool] = True

    def __init__(self, end: ChannelEnd, index: int, subindex: int, first: bytes, door: Door, now: Time) -> None:
        super().__init__(end, index, subindex, first)
        self._door = door
        door.ask(self)
        self.state = HELD
        self.deadline = now + end.stream_timeout

    def feed(self, piece: Buffer, last: bool, now: Time) -> None:
        content = bytes(piece)
        self.instead = answer_upload(self.end, self.index, self.subindex, self.first, self._door, content, not last, now)
        self.state = OVER


class ServerUpload(SegmentedTransfer):
    """Let the client read an object in segments."""

    __slots__ = ("_content", "_door", "_more", "_offset")

    def __init__(
        self, end: ChannelEnd, index: int, subindex: int, first: bytes, door: Door, content: bytes, more: bool, now: Time
    ) -> None:
        super().__init__(end, index, subindex, first)
        self._door = door
        self._content = content
        self._more = more
        self._offset = 0  # what has been sent
        size = door.size if more else len(content)
        command = INITIATE_UPLOAD_RESPONSE if size is None else INITIATE_UPLOAD_RESPONSE | SIZE_BIT
        end.send(pack_initiate(command, index, subindex, size or 0))
        self.due = UPLOAD_SEGMENT
        self.state = SEGMENTS
        self.deadline = now + end.timeout

    def receive(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        due = self.due
        if command & ~0x0F != due or self.state is not SEGMENTS:
            return False
        end, content, offset = self.end, self._content, self._offset
        behind = offset + 7
        if behind < len(content):
            end.last = data
            end.out.frames.append(Frame(end.can_id, HEADS[due & TOGGLE] + content[offset:behind], end.flags))
            self._offset = behind
            self.due = due ^ TOGGLE
            self.deadline = now + end.timeout
        elif self._more:  # the segment may be the last one, or not
            end.last = data
            self.state = HELD
            self._door.ask(self)
            self.deadline = now + end.stream_timeout
        else:
            end.send(segment(due & TOGGLE, content, offset))
            self.state = OVER
        return True

    def feed(self, piece: Buffer, last: bool, now: Time) -> None:
        self._content = self._content[self._offset :] + piece
        self._offset = 0
        self._more = not last
        self.state = SEGMENTS
        request = bytes((self.due,)).ljust(8, b"\x00")
        self.receive(self.due, request, Frame(self.end.can_id, request), now)  # the one that had to wait


class ServerDownload(SegmentReceiver):
    """Let the client write an object in segments."""

    __slots__ = ("_answer", "_door")

    _answer: Frame  # acknowledges the last segment that came

    def __init__(
        self, end: ChannelEnd, index: int, subindex: int, first: bytes, door: Door, size: int | None, most: int, now: Time
    ) -> None:
        """Answers the initiate request, which the store has agreed to. size: as announced. most: bytes of what is held whole."""
        super().__init__(end, index, subindex, first)
        self._door = door
        answer = Frame(end.can_id, pack_initiate(INITIATE_DOWNLOAD_RESPONSE, index, subindex, 0), end.flags)
        announced = UNKNOWN_SIZE if size is None else size
        limit, piece_size = (MAX_SIZE, SUB_BLOCK_SIZE) if door.takes_pieces else (most, MAX_SIZE)
        self._start(DOWNLOAD_SEGMENT, announced, limit, piece_size, answer, now)

    def _complete(self, content: bytes, reply: Frame, now: Time) -> None:
        self._door.write(self, content, self._door.handed, reply, now)

    def _hand_over(self, piece: bytes, reply: Frame, now: Time) -> None:
        size = len(piece)
        self._limit -= size
        self._plain = min(self._limit, self._piece_size)
        if self._announced != UNKNOWN_SIZE:
            self._announced -= size
        self._door.hand_over(self, piece, self._door.handed, more=True)
        self._door.handed += size
        self._answer = reply
        self.state = HELD
        self.deadline = now + self.end.stream_timeout

    def proceed(self, now: Time) -> bool:
        self._go_on(self._answer, now)
        return True
