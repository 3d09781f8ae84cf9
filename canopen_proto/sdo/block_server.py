"""The server of a block transfer: how it begins and ends an upload and a download.

block.py tells how a block transfer goes. In an upload the server announces the size; an object of no bytes is one segment without
data. It answers with a normal upload instead if the client's protocol switch threshold (pst, in bytes) allows that. In a download
the server tells the block size.

An object that the host serves in pieces (`ObjectAccessPending.more`): each sub-block of a download is one, and is acknowledged
when the host has taken it; for an upload the host is asked for the next one while the one before goes out.

Source: CiA 301 v4.2.0, 7.2.4.3.9 and 7.2.4.3.13.
"""

from __future__ import annotations

from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_proto.sdo.block import COPY_TIME, END_RESPONSE_PAYLOAD, MAX_SIZE, receiver_initiate, sender_initiate, silence_limit
from canopen_proto.sdo.block_receiver import BlockReceiver
from canopen_proto.sdo.block_sender import BlockSender
from canopen_proto.sdo.codec import ACKNOWLEDGEMENT, BLOCK_DOWNLOAD, CRC_BIT, KIND, START_UPLOAD, is_initiate
from canopen_proto.sdo.host import Door
from canopen_proto.sdo.transfer import OVER, ChannelEnd


class ServerBlockUpload(BlockSender):
    """Let the client read an object by block transfer."""

    __slots__ = ("_door",)

    def __init__(
        self, end: ChannelEnd, index: int, subindex: int, first: bytes, door: Door, content: bytes, more: bool, now: Time
    ) -> None:
        """Answers the initiate request. more: content is the first piece that the host gives."""
        with_crc = end.crc and bool(first[0] & CRC_BIT)
        super().__init__(end, index, subindex, first, bytearray(content) if more else content, not more, with_crc)
        self._door = door
        announced = door.size if more else len(content)
        end.send(sender_initiate(BLOCK_DOWNLOAD, index, subindex, announced, end.crc))
        self.deadline = now + 2 * silence_limit(end.timeout)

    def _on_answer(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        kind = command & KIND
        if kind == START_UPLOAD:
            block_size = self.first[4]
        elif kind == ACKNOWLEDGEMENT and data[1] == 0:  # the start was lost, and the client asks for the first sub-block
            block_size = data[2]
        else:
            return False
        self.end.last = data
        self._start(block_size, now)
        return True

    def _ask_for_more(self) -> None:
        self._door.ask(self)


class ServerBlockDownload(BlockReceiver):
    """Let the client write an object by block transfer."""

    __slots__ = ("_door",)

    def __init__(
        self, end: ChannelEnd, index: int, subindex: int, first: bytes, door: Door, size: int | None, most: int, now: Time
    ) -> None:
        """Answers the initiate request, which the store has agreed to. size: as announced. most: bytes of what is held whole."""
        super().__init__(end, index, subindex, first, door.takes_pieces)
        self._door = door
        end.send(receiver_initiate(index, subindex, self._choose_block_size(), end.crc))
        limit = MAX_SIZE if door.takes_pieces else most
        self._start(size, limit, end.crc and bool(first[0] & CRC_BIT), now)

    def _hand_over(self, piece: bytes, offset: int) -> None:
        self._door.hand_over(self, piece, offset, more=True)

    def _complete(self, content: bytes, now: Time) -> None:
        self.state = OVER  # behind its end nothing is on the way
        answer = Frame(self.end.can_id, END_RESPONSE_PAYLOAD, self.end.flags)
        self._door.write(self, content, self.offset, answer, now)

    def _on_gap(self, command: int, sequence: int, data: bytes, frame: Frame, now: Time) -> bool:
        """A client that has not got our answer (it was lost, or the request was a late copy) begins again.

        An initiate request has a number from 32 on. Before the first segment 31 or more would have to be lost for it to be one.
        """
        has_heard = self._last_said or self._received or self._heard
        is_copy = data == self.end.last and now < self.deadline - self._silence + COPY_TIME
        if has_heard or is_copy or not is_initiate(command):
            return super()._on_gap(command, sequence, data, frame, now)
        return False
