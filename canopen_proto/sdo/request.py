"""What an SDO client is asked for: a request with its initiate frame, made and checked before it queues up.

Source: CiA 301 v4.2.0, 7.2.4.3.3 and 7.2.4.3.6.
"""

from __future__ import annotations

import struct
from typing import TypeAlias

from canopen_proto.machine import LocalProtocolError, RequestId
from canopen_proto.sdo.codec import (
    EXPEDITED,
    EXPEDITED_BITS,
    INITIATE,
    INITIATE_DOWNLOAD,
    INITIATE_UPLOAD,
    MAX_EXPEDITED,
    SIZE_BIT,
)

Buffer: TypeAlias = bytes | bytearray | memoryview


class Request:
    """first: the data of the initiate frame; content: what to download."""

    __slots__ = ("content", "first", "index", "request_id", "subindex")

    def __init__(self, index: int, subindex: int, first: bytes, content: bytes = b"") -> None:
        self.request_id: RequestId = 0
        self.index = index
        self.subindex = subindex
        self.first = first
        self.content = content

    def is_like(self, other: Request) -> bool:
        """Whether the answers to both look the same."""
        return self.first[1:4] == other.first[1:4] and self.first[0] >> 5 == other.first[0] >> 5

    def __str__(self) -> str:
        return f"{'upload' if self.first[0] == INITIATE_UPLOAD else 'download'} 0x{self.index:04X}:{self.subindex:02X}"


def upload_request(index: int, subindex: int) -> Request:
    """index 0..0xFFFF, subindex 0..0xFF; else LocalProtocolError."""
    try:
        return Request(index, subindex, INITIATE.pack(INITIATE_UPLOAD, index, subindex, 0))
    except struct.error:
        raise _impossible("upload", index, subindex) from None


def download_request(index: int, subindex: int, content: Buffer) -> Request:
    """Expedited where it is 1 to 4 bytes; no bytes at all have no expedited form. Raises LocalProtocolError."""
    if not isinstance(content, bytes):
        if not isinstance(content, bytearray | memoryview):  # bytes(6) would be six zeros
            raise LocalProtocolError(f"download {index!r}:{subindex!r}: bytes expected, not {content!r}")
        content = bytes(content)
    size = len(content)
    try:
        if 0 < size <= MAX_EXPEDITED:
            first = EXPEDITED.pack(INITIATE_DOWNLOAD | EXPEDITED_BITS[size], index, subindex, content)
        else:
            first = INITIATE.pack(INITIATE_DOWNLOAD | SIZE_BIT, index, subindex, size)
    except struct.error:
        raise _impossible("download", index, subindex) from None
    return Request(index, subindex, first, content)


def _impossible(what: str, index: object, subindex: object) -> LocalProtocolError:
    return LocalProtocolError(f"{what} {index!r}:{subindex!r}: index 0..0xFFFF and subindex 0..0xFF expected")
