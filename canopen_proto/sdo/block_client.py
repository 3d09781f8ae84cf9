"""How an SDO client begins and ends block transfers, and what it is asked for there.

block.py tells how a block transfer goes. The client says in its initiate request whether it supports CRC, and, for an upload,
the first block size. The protocol switch threshold (pst), which could allow a normal upload of a small object, is always 0: if
such an object is empty, one server in the field stops at an assertion, and another answers four zeros.

A request for block = "auto" bears the plain request beside it. It falls back on that if the server refuses at the initiation with
0x05040001 (it does not know block transfer; the client remembers that) or 0x06010000 (not this object), and it takes a normal
upload for an answer though it did not allow one: there are servers that do not look at the threshold. A refusal that does not
name the object counts if nothing else comes in time. It is not remembered: it may be about something else, and the answer lost.

Source: CiA 301 v4.2.0, 7.2.4.3.9 and 7.2.4.3.13.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.machine import LocalProtocolError, Time
from canopen_proto.sdo.block import (
    ACKNOWLEDGEMENT,
    BLOCK_SIZE_BIT,
    CRC_BIT,
    END_RESPONSE,
    KIND,
    MAX_SIZE,
    START_UPLOAD,
    chosen_block_size,
    receiver_initiate,
    sender_initiate,
)
from canopen_proto.sdo.block_receiver import HELD, BlockReceiver
from canopen_proto.sdo.block_receiver import STARTING as RECEIVER_STARTING
from canopen_proto.sdo.block_sender import STARTING as SENDER_STARTING
from canopen_proto.sdo.block_sender import BlockSender
from canopen_proto.sdo.codec import (
    ABORT,
    BLOCK_DOWNLOAD,
    BLOCK_UPLOAD,
    INITIATE,
    INITIATE_UPLOAD_RESPONSE,
    SIZE,
    SPECIFIER,
)
from canopen_proto.sdo.events import SdoAborted, SdoChunk, SdoDataWanted, SdoDownloaded, SdoStreamUploaded, SdoUploaded
from canopen_proto.sdo.request import Request, impossible
from canopen_proto.sdo.request_queue import IDLE, UPLOAD_INITIATED

if TYPE_CHECKING:
    from canopen_proto.sdo.client import SdoClient

MAX_FED: Final = 1 << 16
"""Bytes of a download stream that may be held: half a second of a bus at 1 Mbit/s."""
NO_BLOCKS: Final = (AbortCode.INVALID_COMMAND, AbortCode.UNSUPPORTED_ACCESS)
"""How servers refuse block transfer, at its initiation."""

_END_RESPONSE_PAYLOAD: Final = bytes((END_RESPONSE,)).ljust(8, b"\x00")
_START_PAYLOAD: Final = bytes((START_UPLOAD,)).ljust(8, b"\x00")


def lacks_blocks(aborted: SdoAborted) -> bool:
    """Whether a stream ended because the server knows no block transfer, or not for this object: it refused, or answered with a
    normal upload all the same. To be asked only of a stream that had not begun yet."""
    if aborted.origin is AbortOrigin.LOCAL:
        return aborted.abort_code == AbortCode.UNSUPPORTED_ACCESS
    return aborted.origin is AbortOrigin.PEER and aborted.abort_code in NO_BLOCKS


class BlockRequest(Request):
    """A request for a block transfer. plain: what to fall back on. size: announced, of a download. fed: bytes so far."""

    __slots__ = ("crc", "fed", "is_stream", "is_whole", "plain", "size")

    def __init__(self, index: int, subindex: int, first: bytes, crc: bool, is_stream: bool, plain: Request | None) -> None:
        super().__init__(index, subindex, first)
        self.crc = crc
        self.is_stream = is_stream
        self.plain = plain
        self.is_whole = not is_stream
        self.size: int | None = None
        self.fed = 0

    @property
    def room(self) -> int:
        """How many more bytes may be fed now."""
        room = MAX_FED - len(self.content)
        return room if self.size is None else min(room, self.size - self.fed)

    def feed(self, piece: bytes | bytearray | memoryview, last: bool) -> None:
        """See SdoClient.feed; checks only, and counts."""
        size = memoryview(piece).nbytes
        total = self.fed + size
        if self.is_stream and self.is_whole and not size:
            return  # the end of a file whose size was announced
        if self.is_whole or not isinstance(self.content, bytearray):
            raise LocalProtocolError(f"{self}: nothing can be fed: it is no download stream, or it is complete")
        if self.size is not None and (total > self.size or (last and total < self.size)):
            raise LocalProtocolError(f"{self}: {total} bytes fed, {self.size} announced")
        if len(self.content) + size > MAX_FED:
            raise LocalProtocolError(
                f"{self}: {len(self.content)} bytes wait to be sent; with {size} more these are over {MAX_FED}"
            )
        self.fed = total
        self.is_whole = last or total == self.size


def block_upload_request(
    index: int, subindex: int, block_size: int, crc: bool, is_stream: bool, plain: Request | None
) -> BlockRequest:
    """index 0..0xFFFF, subindex 0..0xFF; else LocalProtocolError."""
    try:
        first = receiver_initiate(index, subindex, chosen_block_size(block_size), crc)
    except struct.error:
        raise impossible("block upload", index, subindex) from None
    return BlockRequest(index, subindex, first, crc, is_stream, plain)


def block_download_request(
    index: int, subindex: int, content: bytes | None, size: int | None, crc: bool, plain: Request | None
) -> BlockRequest:
    """content: None for a stream, of `size` bytes or an unknown number. Raises LocalProtocolError."""
    if size is not None and not 0 <= size <= MAX_SIZE:
        raise LocalProtocolError(f"block download {index!r}:{subindex!r}: size 0..0xFFFFFFFF expected, not {size}")
    try:
        first = sender_initiate(BLOCK_DOWNLOAD, index, subindex, size, crc)
    except struct.error:
        raise impossible("block download", index, subindex) from None
    request = BlockRequest(index, subindex, first, crc, content is None, plain)
    request.content = bytearray() if content is None else content
    request.size = size
    request.is_whole = content is not None or size == 0
    return request


def fall_back(client: SdoClient, data: bytes, now: Time) -> bool:
    """Take the server's abort at the initiation: go on by plain transfer if it is blocks that it refused, and we may choose."""
    request = client._request
    assert isinstance(request, BlockRequest)
    plain, abort_code = request.plain, SIZE.unpack_from(data, 4)[0]
    if abort_code == AbortCode.INVALID_COMMAND and data[1:4] == client._multiplexer:  # else it is a guess
        client.serves_blocks = False
    if plain is None or abort_code not in NO_BLOCKS:
        return False
    plain.request_id = request.request_id
    request.content = b""
    client._last = data
    client._ended = now
    client._unsettled = True  # a second copy of the abort may come: copy_guard
    client._state = IDLE
    client._transfer = None
    client._urgent.appendleft(plain)
    client._begin_next(now)
    return True


def take_for_refusal(client: SdoClient, data: bytes, now: Time) -> None:
    """Nothing but an abort without an object's name has come in time: the server has no blocks, or its answer is late.

    So the transfer is aborted on the wire, and the answer is ignored if it comes.
    """
    request = client._request
    client._send(INITIATE.pack(ABORT, request.index, request.subindex, AbortCode.TIMED_OUT))
    client._unsettled = True
    if not fall_back(client, data, now):
        client._end_by_abort(data, False, now)


class BlockDownload(BlockSender):
    """A download that is under way."""

    __slots__ = ("_asked_at", "_client", "_request")

    def __init__(self, client: SdoClient, request: BlockRequest) -> None:
        super().__init__(client, request.content, request.is_whole, request.crc)
        self._client = client
        self._request = request
        self._asked_at = -1  # what had been fed when we last asked for more

    def _wants_more(self) -> None:
        request = self._request
        if self._asked_at != request.fed:
            self._asked_at = request.fed
            wanted = SdoDataWanted(self._client.node_id, request.request_id, request.index, request.subindex, request.room)
            self._client.out.events.append(wanted)

    def _ended(self, now: Time) -> None:
        request = self._request
        outcome = SdoDownloaded(self._client.node_id, request.request_id, request.index, request.subindex)
        self._client._end(outcome, now)

    def _on_other(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        client = self._client
        if self._state == SENDER_STARTING and data[1:4] == client._multiplexer:
            if command & KIND == BLOCK_UPLOAD:  # 101 is the server's specifier for downloads
                client._accept(data)
                self.with_crc = self.with_crc and bool(command & CRC_BIT)
                self._start(data[4], now)
                return
            if command & SPECIFIER == ABORT and fall_back(client, data, now):
                return
        elif self._state == SENDER_STARTING and command & KIND == ACKNOWLEDGEMENT:
            client._ignore(frame, "acknowledgement of a block download whose initiate response was lost")
            return
        client._on_other(command, data, frame, now)


class BlockUpload(BlockReceiver):
    """An upload that is under way."""

    __slots__ = ("_client", "_request")

    def __init__(self, client: SdoClient, request: BlockRequest) -> None:
        super().__init__(client, request.is_stream)
        self._client = client
        self._request = request
        self._block_size = request.first[4]

    def proceed(self, now: Time) -> None:
        """See SdoClient.proceed."""
        if self._state == HELD:
            self._go_on(now)

    def _piece(self, piece: bytes, offset: int, now: Time) -> None:
        request = self._request
        chunk = SdoChunk(self._client.node_id, request.request_id, request.index, request.subindex, offset, piece)
        self._client.out.events.append(chunk)

    def _complete(self, now: Time) -> None:
        client, request = self._client, self._request
        client._send(_END_RESPONSE_PAYLOAD)
        content = bytes(self._buffer)
        node_id, request_id, index, subindex = client.node_id, request.request_id, request.index, request.subindex
        if not request.is_stream:
            client._end(SdoUploaded(node_id, request_id, index, subindex, content), now)
            return
        if content:
            client.out.events.append(SdoChunk(node_id, request_id, index, subindex, self.offset, content))
        client._end(SdoStreamUploaded(node_id, request_id, index, subindex, self.offset + len(content)), now)

    def _on_other(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        client = self._client
        if self._state == RECEIVER_STARTING and data[1:4] == client._multiplexer:
            if command & 0xE1 == BLOCK_DOWNLOAD:  # 110 is the server's specifier for uploads
                self._on_initiated(command, data, now)
                return
            if command & SPECIFIER == INITIATE_UPLOAD_RESPONSE:
                if self._request.plain is not None:
                    client._state = UPLOAD_INITIATED
                    client._transfer = None
                    client._on_upload_initiated(command, data, now)
                    return
                if not client._unsettled and data[:4] != client._last[:4]:  # else it may be an answer to a request before
                    client._fail(AbortCode.UNSUPPORTED_ACCESS, AbortOrigin.LOCAL, now)
                    return
            if command & SPECIFIER == ABORT and fall_back(client, data, now):
                return
        client._on_other(command, data, frame, now)

    def _on_initiated(self, command: int, data: bytes, now: Time) -> None:
        """7.2.4.3.13"""
        client = self._client
        client._accept(data)
        size: int | None = SIZE.unpack_from(data, 4)[0] if command & BLOCK_SIZE_BIT else None
        limit = MAX_SIZE if self._request.is_stream else client.max_upload
        if size is not None and size > limit:
            client._fail(AbortCode.OUT_OF_MEMORY, AbortOrigin.LOCAL, now)
            return
        client._send(_START_PAYLOAD)
        self._last_said = _START_PAYLOAD
        self._start(size, limit, self._request.crc and bool(command & CRC_BIT), now)
