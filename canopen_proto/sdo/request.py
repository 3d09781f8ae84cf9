"""What an SDO client is asked for: a request with its initiate frame, made and checked before it queues up.

Source: CiA 301 v4.2.0, 7.2.4.3.3 and 7.2.4.3.6.
"""

from __future__ import annotations

import struct
from typing import TypeAlias

from canopen_proto.machine import LocalProtocolError, RequestId
from canopen_proto.sdo.codec import (
    BLOCK_UPLOAD,
    EXPEDITED,
    EXPEDITED_BITS,
    INITIATE,
    INITIATE_DOWNLOAD,
    INITIATE_UPLOAD,
    MAX_EXPEDITED,
    SIZE_BIT,
    SPECIFIER,
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
        self.content: bytes | bytearray = content

    def is_like(self, other: Request) -> bool:
        """Whether the answers to both look the same."""
        return self.first[1:4] == other.first[1:4] and self.first[0] >> 5 == other.first[0] >> 5

    def __str__(self) -> str:
        is_upload = self.first[0] & SPECIFIER in (INITIATE_UPLOAD, BLOCK_UPLOAD)
        return f"{'upload' if is_upload else 'download'} 0x{self.index:04X}:{self.subindex:02X}"


def upload_request(index: int, subindex: int) -> Request:
    """index 0..0xFFFF, subindex 0..0xFF; else LocalProtocolError."""
    try:
        return Request(index, subindex, INITIATE.pack(INITIATE_UPLOAD, index, subindex, 0))
    except struct.error:
        raise impossible("upload", index, subindex) from None


def download_request(index: int, subindex: int, content: Buffer) -> Request:
    """Expedited where it is 1 to 4 bytes; no bytes at all have no expedited form. Raises LocalProtocolError."""
    if not isinstance(content, bytes):
        content = own(content, index, subindex)
    size = len(content)
    try:
        if 0 < size <= MAX_EXPEDITED:
            first = EXPEDITED.pack(INITIATE_DOWNLOAD | EXPEDITED_BITS[size], index, subindex, content)
        else:
            first = INITIATE.pack(INITIATE_DOWNLOAD | SIZE_BIT, index, subindex, size)
    except struct.error:
        raise impossible("download", index, subindex) from None
    return Request(index, subindex, first, content)


def own(content: Buffer, index: int, subindex: int) -> bytes:
    """The content as bytes, which nobody changes while the request waits; else LocalProtocolError."""
    if not isinstance(content, bytes | bytearray | memoryview):  # bytes(6) would be six zeros
        raise LocalProtocolError(f"download {index!r}:{subindex!r}: bytes expected, not {content!r}")
    return bytes(content)  # the same object if it is bytes already


def impossible(what: str, index: object, subindex: object) -> LocalProtocolError:
    """An index or subindex that no frame can carry."""
    return LocalProtocolError(f"{what} {index!r}:{subindex!r}: index 0..0xFFFF and subindex 0..0xFF expected")
