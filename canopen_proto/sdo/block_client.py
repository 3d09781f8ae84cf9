"""The client of a block transfer: how it begins and ends a download and an upload, and how it falls back on plain transfer.

block.py tells how a block transfer goes. The client says in its initiate request whether it supports CRC, and, for an upload,
the first block size. The protocol switch threshold (pst), which could allow a normal upload of a small object, is always 0: if
such an object is empty, one server in the field stops at an assertion, and another answers four zeros.

A request for block = "auto" has the plain request with it, and becomes that one (`instead`) if the server refuses at the
initiation with 0x05040001 (it does not know block transfer; the client remembers that) or 0x06010000 (not this object). It also
takes a normal upload for an answer though it did not allow one: some servers do not look at the threshold. A refusal that does
not name the object counts if nothing else comes in time. It is not remembered: it may be about something else, and the answer
lost.

Source: CiA 301 v4.2.0, 7.2.4.3.9 and 7.2.4.3.13.
"""

from __future__ import annotations

import struct
from typing import Final

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.machine import LocalProtocolError, Time
from canopen_proto.sdo.block import END_RESPONSE_PAYLOAD, MAX_SIZE, chosen_block_size, receiver_initiate, sender_initiate
from canopen_proto.sdo.block_receiver import BlockReceiver
from canopen_proto.sdo.block_sender import BlockSender
from canopen_proto.sdo.codec import (
    ACKNOWLEDGEMENT,
    BLOCK_DOWNLOAD,
    BLOCK_SIZE_BIT,
    BLOCK_UPLOAD,
    CRC_BIT,
    INITIATE_UPLOAD_RESPONSE,
    KIND,
    SIZE,
    SPECIFIER,
    START_UPLOAD,
)
from canopen_proto.sdo.events import SdoAborted, SdoChunk, SdoDataWanted, SdoDownloaded, SdoStreamUploaded, SdoUploaded
from canopen_proto.sdo.segmented_client import Download, Upload, impossible
from canopen_proto.sdo.transfer import INITIATED, OVER, Buffer, ChannelEnd, Transfer

MAX_FED: Final = 1 << 16
"""Bytes of a download stream that may be held: half a second of a bus at 1 Mbit/s."""
NO_BLOCKS: Final = (AbortCode.INVALID_COMMAND, AbortCode.UNSUPPORTED_ACCESS)
"""How servers refuse block transfer, at its initiation."""

_START_PAYLOAD: Final = bytes((START_UPLOAD,)).ljust(8, b"\x00")


def lacks_blocks(aborted: SdoAborted) -> bool:
    """Return whether a stream ended because the server has no block transfer, or not for this object: it refused, or answered
    with a normal upload all the same. Ask only about a stream that had not begun yet."""
    if aborted.origin is AbortOrigin.LOCAL:
        return aborted.abort_code == AbortCode.UNSUPPORTED_ACCESS
    return aborted.origin is AbortOrigin.PEER and aborted.abort_code in NO_BLOCKS


class BlockDownload(BlockSender):
    """Write an object by block transfer, all at once or as a stream."""

    __slots__ = ("_asked_at", "_fed", "_size")

    def __init__(
        self, end: ChannelEnd, index: int, subindex: int, content: bytes | None, size: int | None, plain: Download | None = None
    ) -> None:
        """content: None for a stream, of `size` bytes or an unknown number. plain: what to fall back on.

        Raises LocalProtocolError if a number is out of range.
        """
        if size is not None and not 0 <= size <= MAX_SIZE:
            raise LocalProtocolError(f"block download {index!r}:{subindex!r}: size 0..0xFFFFFFFF expected, not {size}")
        try:
            first = sender_initiate(BLOCK_DOWNLOAD, index, subindex, size, end.crc)
        except struct.error:
            raise impossible("block download", index, subindex) from None
        is_whole = content is not None or size == 0
        super().__init__(end, index, subindex, first, bytearray() if content is None else content, is_whole, end.crc)
        self._size = size
        self.plain = plain
        self._fed = 0
        self._asked_at = -1  # what had been fed when we last asked for more

    @property
    def room(self) -> int:
        if self._is_whole:
            return 0
        room = MAX_FED - len(self._content)
        return room if self._size is None else min(room, self._size - self._fed)

    def feed(self, piece: Buffer, last: bool, now: Time) -> None:
        size = memoryview(piece).nbytes
        total, waiting = self._fed + size, len(self._content)
        is_stream = isinstance(self._content, bytearray)
        if is_stream and self._is_whole and not size:
            return  # the end of a file whose size was announced
        if self._is_whole:
            raise LocalProtocolError(f"{self}: nothing can be fed: it is no download stream, or it is complete")
        if self._size is not None and (total > self._size or (last and total < self._size)):
            raise LocalProtocolError(f"{self}: {total} bytes fed, {self._size} announced")
        if waiting + size > MAX_FED:
            raise LocalProtocolError(f"{self}: {waiting} bytes are waiting to be sent; {size} more would exceed {MAX_FED}")
        self._fed = total
        super().feed(piece, last or total == self._size, now)

    def again(self) -> Transfer | None:
        content = self._content
        if not isinstance(content, bytes):
            return None
        plain = None if self.plain is None else Download(self.end, self.index, self.subindex, content)
        return BlockDownload(self.end, self.index, self.subindex, content, len(content), plain)

    def _ask_for_more(self) -> None:
        if self._asked_at != self._fed:
            self._asked_at = self._fed
            end = self.end
            end.out.events.append(SdoDataWanted(end.node_id, self.request_id, self.index, self.subindex, self.room))

    def _on_answer(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        if data[1:4] == self.name:
            if command & KIND != BLOCK_UPLOAD:  # 101 is the server's specifier for downloads
                return False
            self.end.last = data
            self.is_answered = True
            self._with_crc = self._with_crc and bool(command & CRC_BIT)
            self._start(data[4], now)
            return True
        if command & KIND == ACKNOWLEDGEMENT:
            self.end.ignore(frame, "acknowledgement of a block download whose initiate response was lost")
            return True
        return False

    def _report_success(self) -> None:
        end = self.end
        end.out.events.append(SdoDownloaded(end.node_id, self.request_id, self.index, self.subindex))


class BlockUpload(BlockReceiver):
    """Read an object by block transfer, all at once or as a stream."""

    __slots__ = ("_crc_offered", "_most")

    def __init__(
        self, end: ChannelEnd, index: int, subindex: int, is_stream: bool, most: int, plain: Upload | None = None
    ) -> None:
        """most: bytes that are accepted. plain: what to fall back on. Raises LocalProtocolError if a number is out of range."""
        try:
            first = receiver_initiate(index, subindex, chosen_block_size(end.block_size), end.crc)
        except struct.error:
            raise impossible("block upload", index, subindex) from None
        super().__init__(end, index, subindex, first, is_stream)
        self._block_size = first[4]
        self._crc_offered = end.crc
        self._most = most
        self.plain = plain

    def again(self) -> Transfer | None:
        if self._is_stream:
            return None
        plain = None if self.plain is None else Upload(self.end, self.index, self.subindex, self._most)
        return BlockUpload(self.end, self.index, self.subindex, False, self._most, plain)

    def _on_answer(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        if data[1:4] != self.name:
            return False
        if command & 0xE1 == BLOCK_DOWNLOAD:  # 110 is the server's specifier for uploads
            self._on_initiated(command, data, now)
            return True
        plain = self.plain
        if plain is None or command & SPECIFIER != INITIATE_UPLOAD_RESPONSE:
            return False
        plain.request_id, plain.is_urgent, plain.first = self.request_id, self.is_urgent, self.first
        plain.own_timeout = self.own_timeout
        plain.receive(command, data, frame, now)
        self.instead = plain
        self.state = OVER
        return True

    def fault_of(self, command: int) -> AbortCode:
        is_plain = self.state is INITIATED and command & SPECIFIER == INITIATE_UPLOAD_RESPONSE
        return AbortCode.UNSUPPORTED_ACCESS if is_plain else AbortCode.INVALID_COMMAND

    def _on_initiated(self, command: int, data: bytes, now: Time) -> None:
        """7.2.4.3.13"""
        end = self.end
        end.last = data
        self.is_answered = True
        size: int | None = SIZE.unpack_from(data, 4)[0] if command & BLOCK_SIZE_BIT else None
        if size is not None and size > self._most:
            self.abort(AbortCode.OUT_OF_MEMORY)
            return
        end.send(_START_PAYLOAD)
        self._last_said = _START_PAYLOAD
        self._start(size, self._most, self._crc_offered and bool(command & CRC_BIT), now)

    def _hand_over(self, piece: bytes, offset: int) -> None:
        end = self.end
        end.out.events.append(SdoChunk(end.node_id, self.request_id, self.index, self.subindex, offset, piece))

    def _complete(self, content: bytes, now: Time) -> None:
        end = self.end
        end.send(END_RESPONSE_PAYLOAD)
        if not self._is_stream:
            end.out.events.append(SdoUploaded(end.node_id, self.request_id, self.index, self.subindex, content))
        else:
            if content:
                self._hand_over(content, self.offset)
            size = self.offset + len(content)
            end.out.events.append(SdoStreamUploaded(end.node_id, self.request_id, self.index, self.subindex, size))
        self.state = OVER
