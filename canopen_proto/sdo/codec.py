"""How SDO frames are laid out: command bytes, and what client and server share.

Every SDO frame has eight bytes. The first is the command byte, whose three highest bits are the command specifier (ccs in the
client's frames, scs in the server's). Numbers are little-endian. CiA 301 v4.2.0, 7.2.4.3.2 to 7.2.4.3.7 and 7.2.4.3.17:

                                    client to server         server to client        bytes 1..7
    initiate download               001x nnes                011x xxxx               index (2), subindex, data or size (4)
    download segment                000t nnnc                001t xxxx               7 of data, the last n unused
    initiate upload                 010x xxxx                010x nnes               index (2), subindex, data or size (4)
    upload segment                  011t xxxx                000t nnnc               7 of data, the last n unused
    abort transfer                  100x xxxx                100x xxxx               index (2), subindex, abort code (4)
    block upload, block download    101, 110                 110, 101                (block.py)

    t toggle   n unused bytes   c no more segments   e expedited   s size (n or the size field) is indicated   x reserved

Download = client to server. Reserved bits are sent as 0 and not looked at. e = 1, s = 0 is expedited data of unspecified size,
all four bytes; e = 0, s = 0 a segmented transfer whose size is not announced.

Short frames: some servers in the field send less than eight bytes if the rest is unused. The bytes that the command byte
announces have to be there; the others count as zeros. See `complete`.
"""

from __future__ import annotations

import struct
from typing import Final

INITIATE: Final = struct.Struct("<BHBI")
"""Command, index, subindex, and size or abort code (or nothing)."""
EXPEDITED: Final = struct.Struct("<BHB4s")
"""Command, index, subindex, up to four bytes of data; fewer are filled with zeros."""
MULTIPLEXER: Final = struct.Struct("<xHB4x")
"""Index and subindex alone."""
SIZE: Final = struct.Struct("<I")

# Command bytes
INITIATE_DOWNLOAD: Final = 0x20
INITIATE_UPLOAD: Final = 0x40
INITIATE_UPLOAD_RESPONSE: Final = 0x40
INITIATE_DOWNLOAD_RESPONSE: Final = 0x60
DOWNLOAD_SEGMENT: Final = 0x00
UPLOAD_SEGMENT: Final = 0x60
UPLOAD_SEGMENT_RESPONSE: Final = 0x00
DOWNLOAD_SEGMENT_RESPONSE: Final = 0x20
ABORT: Final = 0x80
BLOCK_UPLOAD: Final = 0xA0
BLOCK_DOWNLOAD: Final = 0xC0

# and their bits
SPECIFIER: Final = 0xE0
TOGGLE: Final = 0x10
LAST: Final = 0x01
EXPEDITED_BIT: Final = 0x02
SIZE_BIT: Final = 0x01

HEADS: Final = tuple(bytes((command,)) for command in range(128))
"""The first byte of a segment as bytes: its command byte, or in a block transfer its number."""

NO_MULTIPLEXER: Final = bytes(3)
"""The object in an abort of a server that has no transfer under way."""


MAX_EXPEDITED: Final = 4
EXPEDITED_BITS: Final = tuple((MAX_EXPEDITED - size) << 2 | EXPEDITED_BIT | SIZE_BIT for size in range(MAX_EXPEDITED + 1))
"""By size, 1..4 bytes: the bits n, e and s of an expedited transfer. (No bytes at all have no expedited form.)"""


def segment(toggle: int, content: bytes, offset: int) -> bytes:
    """Make the segment of `content` from `offset` on, with the last-bit if the content ends with it. CiA 301, 7.2.4.3.4, .7"""
    end = offset + 7
    unused = end - len(content)
    if unused < 0:
        return HEADS[toggle] + content[offset:end]
    return HEADS[toggle | unused << 1 | LAST] + content[offset:end] + bytes(unused)


def _least_length(command: int, expedited_specifier: int, bare_specifier: int) -> int:
    """Return how many bytes of a frame its command byte announces."""
    specifier = command & SPECIFIER
    if specifier == DOWNLOAD_SEGMENT:
        return 8 - (command >> 1 & 7)
    if specifier == bare_specifier:
        return 1
    if specifier == expedited_specifier and command & EXPEDITED_BIT:
        return 8 - (command >> 2 & 3) if command & SIZE_BIT else 5
    if specifier in (BLOCK_UPLOAD, BLOCK_DOWNLOAD):
        return 1
    return 4


LEAST_REQUEST: Final = tuple(_least_length(command, INITIATE_DOWNLOAD, UPLOAD_SEGMENT) for command in range(256))
"""By command byte: the least length of a client's frame that makes sense."""
LEAST_RESPONSE: Final = tuple(
    _least_length(command, INITIATE_UPLOAD_RESPONSE, DOWNLOAD_SEGMENT_RESPONSE) for command in range(256)
)
"""The same for a server's frame."""


def complete(data: bytes, least: tuple[int, ...]) -> bytes | None:
    """Return a frame's data as eight bytes, or None if bytes are missing that its command byte announces."""
    if not data or len(data) < least[data[0]]:
        return None
    return data[:8].ljust(8, b"\x00")


def what_was_asked(request: bytes) -> str:
    """Return what a client did by a request (eight bytes), as in "asked for 0x1018:01". "" for no bytes."""
    if not request:
        return ""
    command = request[0]
    specifier = command & SPECIFIER
    index, subindex = MULTIPLEXER.unpack(request)
    place = f"0x{index:04X}:{subindex:02X}"
    if specifier == ABORT:
        return f"aborted the transfer of {place} with 0x{SIZE.unpack_from(request, 4)[0]:08X}"
    if specifier == INITIATE_DOWNLOAD:
        return f"wrote {place}" if command & EXPEDITED_BIT else f"began to write {place}"
    if specifier == INITIATE_UPLOAD:
        return f"asked for {place}"
    if specifier == DOWNLOAD_SEGMENT:
        return "sent a segment of a write"
    if specifier == UPLOAD_SEGMENT:
        return "asked for a segment of a read"
    if specifier == BLOCK_UPLOAD and not command & 3:
        return f"began a block read of {place}"
    if specifier == BLOCK_DOWNLOAD and not command & 1:
        return f"began a block write of {place}"
    return f"sent a frame of a block transfer (command 0x{command:02X})"
