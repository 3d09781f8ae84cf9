"""The SDO transfers of a recorded session, read without any code of ours, so that a fault of our codec cannot hide in it.

CiA 301 v4.2.0, 7.2.4.3. Recordings are taken to be whole and without a lost frame, and blocks to have 127 segments.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field


@dataclass
class Transfer:
    """One transfer. data: what went up or down. abort_code: of the server's abort. complete: it has ended, either way; else the
    recording ends before, or the client gave it up."""

    is_upload: bool
    is_block: bool
    index: int
    subindex: int
    data: bytes = b""
    abort_code: int | None = None
    complete: bool = False
    _segments: list[bytes] = field(default_factory=list, repr=False)
    _in_block: bool = field(default=False, repr=False)  # the next frame of whoever sends the data is a segment of a block
    _was_last: bool = field(default=False, repr=False)

    def read(self, data: bytes, by_client: bool) -> None:
        """Take a frame that belongs to it."""
        command, specifier = data[0], data[0] >> 5
        carries_data = by_client != self.is_upload
        if self._in_block and carries_data:
            self._segments.append(data[1:])
            self._was_last = bool(command & 0x80)
            self._in_block = not self._was_last and command != 127
        elif specifier == 4:
            self.complete = not by_client
            self.abort_code = None if by_client else int.from_bytes(data[4:], "little")
        elif self.is_block:
            self._read_block(command, carries_data)
        elif carries_data and specifier == (1 if by_client else 2):  # initiate: expedited, or followed by segments
            if command & 2:
                self._end(data[4 : 8 - (command >> 2 & 3)])
        elif carries_data and specifier == 0:
            self._segments.append(data[1 : 8 - (command >> 1 & 7)])
            self._was_last = bool(command & 1)
            if self._was_last:
                self._end(b"".join(self._segments))
        elif not carries_data and not by_client:  # the confirmation of a download, or of a segment
            self.complete = bool(self.data)

    def _read_block(self, command: int, carries_data: bool) -> None:
        if carries_data:
            if command & 0xE3 == 0xC1:  # end, with the number of unused bytes in the last segment
                whole = b"".join(self._segments)
                self.data = whole[: len(whole) - (command >> 2 & 7)]
        elif command == 0xA1:
            self.complete = True
        elif command & 3 or not self.is_upload:  # start, acknowledgement; a server's answer to the initiate of a download
            self._in_block = not self._was_last

    def _end(self, data: bytes) -> None:
        self.data = data
        self.complete = self.is_upload


def transfers_of(frames: Iterable[tuple[bool, bytes]]) -> list[Transfer]:
    """The transfers of these SDO frames, each with whether the client sent it."""
    transfers: list[Transfer] = []
    for by_client, data in frames:
        within_block = bool(transfers) and transfers[-1]._in_block and by_client != transfers[-1].is_upload
        if by_client and not within_block and is_initiate(data):
            specifier = data[0] >> 5
            is_upload, is_block = specifier in (2, 5), specifier in (5, 6)
            transfers.append(Transfer(is_upload, is_block, int.from_bytes(data[1:3], "little"), data[3]))
        transfers[-1].read(data, by_client)
    return transfers


def is_initiate(data: bytes) -> bool:
    """Whether a client's frame, not being a segment of a block, begins a transfer."""
    command, specifier = data[0], data[0] >> 5
    return specifier in (1, 2) or (specifier == 5 and not command & 3) or (specifier == 6 and not command & 1)
