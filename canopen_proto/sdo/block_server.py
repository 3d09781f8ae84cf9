"""How an SDO server begins and ends block transfers.

block.py tells how a block transfer goes. In an upload the server announces the size; an object of no bytes is one segment without
data. It answers with a normal upload instead if the client's protocol switch threshold (pst, in bytes) allows that. In a download
the server tells the block size.

An object that the host serves in pieces (`ObjectAccessPending.more`): each sub-block of a download is one, and is acknowledged
when the host has taken it; for an upload the host is asked for the next one while the one before goes out.

Source: CiA 301 v4.2.0, 7.2.4.3.9 and 7.2.4.3.13.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_proto.sdo.block import (
    ACKNOWLEDGEMENT,
    BLOCK_SIZE_BIT,
    COPY_TIME,
    CRC_BIT,
    END_RESPONSE,
    KIND,
    MAX_SIZE,
    START_UPLOAD,
    is_initiate,
    receiver_initiate,
    sender_initiate,
)
from canopen_proto.sdo.block_receiver import BlockReceiver
from canopen_proto.sdo.block_sender import STARTING, BlockSender
from canopen_proto.sdo.codec import BLOCK_DOWNLOAD, SIZE

if TYPE_CHECKING:
    from canopen_proto.sdo.server import SdoServer

_END_RESPONSE_PAYLOAD: Final = bytes((END_RESPONSE,)).ljust(8, b"\x00")


class BlockServerUpload(BlockSender):
    """An upload that is under way."""

    __slots__ = ("_server", "_wanted_block_size")

    def __init__(self, server: SdoServer, request: bytes, content: bytes, more: bool, size: int | None, now: Time) -> None:
        """Answers the initiate request. size: of the whole, if the host gives it in pieces and knows."""
        super().__init__(server, bytearray(content) if more else content, not more, server.crc and bool(request[0] & CRC_BIT))
        self._server = server
        self._wanted_block_size = request[4]
        announced = size if more else len(content)
        server._send(sender_initiate(BLOCK_DOWNLOAD, server._index, server._subindex, announced, server.crc))
        server._arm(now + self._patience)

    def _wants_more(self) -> None:
        self._server._ask_for_piece()

    def _ended(self, now: Time) -> None:
        self._server._become_idle()

    def _on_other(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        server = self._server
        if self._state == STARTING:
            kind = command & KIND
            if kind == START_UPLOAD:
                server._last = data
                self._start(self._wanted_block_size, now)
                return
            if kind == ACKNOWLEDGEMENT and data[1] == 0:  # the start was lost, and the client asks for the first sub-block
                server._last = data
                self._start(data[2], now)
                return
        server._on_other(command, data, frame, now)


class BlockServerDownload(BlockReceiver):
    """A download that is under way."""

    __slots__ = ("_server",)

    def __init__(self, server: SdoServer, request: bytes, size: int | None, in_pieces: bool, now: Time) -> None:
        """Answers the initiate request, which the store has agreed to."""
        super().__init__(server, in_pieces)
        self._server = server
        self.with_crc = server.crc and bool(request[0] & CRC_BIT)
        self._size = size
        server._send(receiver_initiate(server._index, server._subindex, self._choose_block_size(), server.crc))
        self._start(size, MAX_SIZE if in_pieces else server.max_download, self.with_crc, now)

    def taken(self, now: Time) -> None:
        """The host has taken the piece."""
        self._go_on(now)

    def _piece(self, piece: bytes, offset: int, now: Time) -> None:
        self._server._hand_over_piece(piece, offset)

    def _complete(self, now: Time) -> None:
        server = self._server
        server._transfer = None  # behind its end nothing is on the way
        answer = Frame(server._send_can_id, _END_RESPONSE_PAYLOAD, server._send_flags, 8)
        content = bytes(self._buffer)
        if self._is_stream:
            server._await_host(content, answer, now, self.offset)
        else:
            server._write(content, answer, now)

    def _on_gap(self, command: int, sequence: int, data: bytes, frame: Frame, now: Time) -> None:
        """A client whose request was answered in vain (the answer was lost, or the request was a late copy) begins again.

        An initiate request has a number from 32 on. Before the first segment 31 or more would have to be lost for it to be one.
        """
        server = self._server
        has_heard = self._last_said or self._received or self._heard
        is_copy = data == server._last and now < server.deadline - self._silence + COPY_TIME
        if has_heard or is_copy or not is_initiate(command):
            super()._on_gap(command, sequence, data, frame, now)
        else:
            server._on_other(command, data, frame, now)

    def _on_other(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        self._server._on_other(command, data, frame, now)


def announced_size(request: bytes) -> int | None:
    """What a block download's initiate request says of its size."""
    size: int = SIZE.unpack_from(request, 4)[0]
    return size if request[0] & BLOCK_SIZE_BIT else None


def may_switch(request: bytes, size: int) -> bool:
    """Whether a block upload's initiate request allows a normal upload of so many bytes."""
    return 0 < request[5] >= size
