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

`REQUESTS` and `RESPONSES` say by the command byte what a frame is (`SdoFrame`). What takes frames apart beside the transfers
themselves (the observer, the conformance cases, the faults of a `World`, a client that hears others) does it by these tables and
by the functions behind them. The transfers look at the bits themselves: each frame of the bus passes there.

Download = client to server. Reserved bits are sent as 0 and not looked at. e = 1, s = 0 is expedited data of unspecified size,
all four bytes; e = 0, s = 0 a segmented transfer whose size is not announced.

Short frames: some servers in the field send less than eight bytes if the rest is unused. The bytes that the command byte
announces have to be there; the others count as zeros. See `complete`.
"""

from __future__ import annotations

import struct
from enum import Enum
from typing import Final

from canopen_proto.multiplexer import Mux, mux, mux_text

_INITIATE: Final = struct.Struct("<BHBI")
_EXPEDITED: Final = struct.Struct("<BHB4s")
_MULTIPLEXER: Final = struct.Struct("<xHB4x")

# Functions, since each frame goes through one: the attribute of an imported name takes as long as the work itself
pack_initiate: Final = _INITIATE.pack
"""Make a frame of command, index, subindex, and size or abort code (or nothing)."""
unpack_initiate: Final = _INITIATE.unpack
pack_expedited: Final = _EXPEDITED.pack
"""Make a frame of command, index, subindex, up to four bytes of data; fewer are filled with zeros."""
unpack_multiplexer: Final = _MULTIPLEXER.unpack
"""Return the index and subindex that a frame names."""
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
END_RESPONSE: Final = 0xA1
ACKNOWLEDGEMENT: Final = 0xA2
START_UPLOAD: Final = 0xA3
BLOCK_DOWNLOAD: Final = 0xC0
END: Final = 0xC1

# and their bits
SPECIFIER: Final = 0xE0
TOGGLE: Final = 0x10
LAST: Final = 0x01
EXPEDITED_BIT: Final = 0x02
SIZE_BIT: Final = 0x01
KIND: Final = 0xE3
"""The bits that tell END_RESPONSE, ACKNOWLEDGEMENT, START_UPLOAD and END apart."""
CRC_BIT: Final = 0x04
BLOCK_SIZE_BIT: Final = 0x02
"""The size of the data is indicated, in an initiate frame of the sender of a block transfer."""

# The first byte of a segment of a block transfer
FINAL: Final = 0x80
SEQUENCE: Final = 0x7F
LEAST_INITIATE: Final = 0x20
"""The lowest sequence number that the first byte of an initiate request looks like."""

HEADS: Final = tuple(bytes((command,)) for command in range(128))
"""The first byte of a segment as bytes: its command byte, or in a block transfer its number."""

NO_MULTIPLEXER: Final = bytes(3)
"""The object in an abort of a server that has no transfer under way."""


MAX_EXPEDITED: Final = 4
EXPEDITED_BITS: Final = tuple((MAX_EXPEDITED - size) << 2 | EXPEDITED_BIT | SIZE_BIT for size in range(MAX_EXPEDITED + 1))
"""By size, 1..4 bytes: the bits n, e and s of an expedited transfer. (No bytes at all have no expedited form.)"""


def segment(toggle: int, content: bytes, offset: int) -> bytes:
    """Make the segment of `content` from `offset` on, with the last-bit if the content ends with it. CiA 301, 7.2.4.3.4, .7
    toggle: 0 or 0x10."""
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
    """Return a frame's data as eight bytes, or None if bytes are missing that its command byte announces. least: by command byte,
    the fewest bytes that make sense."""
    if not data or len(data) < least[data[0]]:
        return None
    return data[:8].ljust(8, b"\x00")


# ---- frames taken apart ----


class SdoFrame(Enum):
    """What a frame is. A response is named like its request; the segments of a block transfer have no name."""

    DOWNLOAD = "initiate download"
    UPLOAD = "initiate upload"
    DOWNLOAD_SEGMENT = "download segment"
    UPLOAD_SEGMENT = "upload segment"
    ABORT = "abort transfer"
    BLOCK_DOWNLOAD = "initiate block download"
    BLOCK_UPLOAD = "initiate block upload"
    BLOCK_START = "start block upload"
    BLOCK_ACKNOWLEDGEMENT = "acknowledge sub-block"
    BLOCK_END = "end block transfer"
    BLOCK_END_RESPONSE = "end block transfer response"
    UNKNOWN = "none that the standard has"


_COMMANDS: Final = (
    (INITIATE_DOWNLOAD, INITIATE_DOWNLOAD_RESPONSE, SdoFrame.DOWNLOAD),
    (INITIATE_UPLOAD, INITIATE_UPLOAD_RESPONSE, SdoFrame.UPLOAD),
    (DOWNLOAD_SEGMENT, DOWNLOAD_SEGMENT_RESPONSE, SdoFrame.DOWNLOAD_SEGMENT),
    (UPLOAD_SEGMENT, UPLOAD_SEGMENT_RESPONSE, SdoFrame.UPLOAD_SEGMENT),
    (ABORT, ABORT, SdoFrame.ABORT),
    (BLOCK_DOWNLOAD, BLOCK_UPLOAD, SdoFrame.BLOCK_DOWNLOAD),  # the server's specifiers are the other way round
    (BLOCK_UPLOAD, BLOCK_DOWNLOAD, SdoFrame.BLOCK_UPLOAD),
    (START_UPLOAD, START_UPLOAD, SdoFrame.BLOCK_START),  # a client's only
    (ACKNOWLEDGEMENT, ACKNOWLEDGEMENT, SdoFrame.BLOCK_ACKNOWLEDGEMENT),
    (END, END, SdoFrame.BLOCK_END),
    (END_RESPONSE, END_RESPONSE, SdoFrame.BLOCK_END_RESPONSE),
)
"""The command bytes of client and server, with none of the bits that `_named_by` leaves out."""


def _named_by(command: int) -> int:
    """Return the bits of a command byte that say what the frame is."""
    if command < BLOCK_UPLOAD:
        return command & SPECIFIER
    bits = command & KIND
    return BLOCK_DOWNLOAD if bits == BLOCK_DOWNLOAD | BLOCK_SIZE_BIT else bits


_NAMES: Final = tuple({row[side]: row[2] for row in _COMMANDS} for side in (0, 1))
REQUESTS: Final = tuple(_NAMES[0].get(_named_by(command), SdoFrame.UNKNOWN) for command in range(256))
"""By command byte: what a client's frame is, unless it is a segment of a block transfer."""
RESPONSES: Final = tuple(_NAMES[1].get(_named_by(command), SdoFrame.UNKNOWN) for command in range(256))
"""The same for a server's frame."""
INITIATES: Final = (SdoFrame.DOWNLOAD, SdoFrame.UPLOAD, SdoFrame.BLOCK_DOWNLOAD, SdoFrame.BLOCK_UPLOAD)
"""The frames that begin a transfer, and name its object."""


def is_initiate(command: int) -> bool:
    """Return whether a client's frame begins a transfer of any kind. command: its command byte."""
    return REQUESTS[command] in INITIATES


def mux_in(frame: bytes) -> Mux:
    """Return the object that a frame names, of those that name one: initiate frames and aborts."""
    return mux(frame[1] | frame[2] << 8, frame[3])


def number_in(frame: bytes) -> int:
    """Return the number in the last four bytes: the code of an abort, the size of an initiate frame."""
    return int.from_bytes(frame[4:8], "little")


def announced_size(frame: bytes) -> int | None:
    """Return the bytes of data that an initiate frame of the side that sends them announces; None if it announces no size."""
    return number_in(frame) if frame[0] & (SIZE_BIT if frame[0] < BLOCK_UPLOAD else BLOCK_SIZE_BIT) else None


def expedited_data(frame: bytes) -> bytes | None:
    """Return the data in an initiate frame, four bytes if it does not say how many; None if the data come in segments."""
    command = frame[0]
    if not command & EXPEDITED_BIT:
        return None
    return frame[4 : 8 - (command >> 2 & 3)] if command & SIZE_BIT else frame[4:8]


def segment_data(frame: bytes) -> bytes:
    """Return the data in a segment, of a download or an upload."""
    return frame[1 : 8 - (frame[0] >> 1 & 7)]


def unused_at_end(frame: bytes) -> int:
    """Return how many bytes of the last segment are unused, 0 to 7. frame: an "end block transfer", which says it."""
    return frame[0] >> 2 & 7


_ASKED: Final = {
    SdoFrame.DOWNLOAD: "began to write {place}",
    SdoFrame.UPLOAD: "asked for {place}",
    SdoFrame.DOWNLOAD_SEGMENT: "sent a segment of a write",
    SdoFrame.UPLOAD_SEGMENT: "asked for a segment of a read",
    SdoFrame.ABORT: "aborted the transfer of {place} with 0x{number:08X}",
    SdoFrame.BLOCK_DOWNLOAD: "began a block write of {place}",
    SdoFrame.BLOCK_UPLOAD: "began a block read of {place}",
}


def what_was_asked(request: bytes) -> str:
    """Return what a client did by a request (eight bytes), as in "asked for 0x1018:01". "" for no bytes."""
    if not request:
        return ""
    asked = REQUESTS[request[0]]
    text = _ASKED.get(asked, f"sent a frame of a block transfer (command 0x{request[0]:02X})")
    if asked is SdoFrame.DOWNLOAD and request[0] & EXPEDITED_BIT:
        text = "wrote {place}"
    return text.format(place=mux_text(mux_in(request)), number=number_in(request))
