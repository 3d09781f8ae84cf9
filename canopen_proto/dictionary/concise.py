"""Concise DCF: the settings of one device as plain bytes (CiA 302-3, object 0x1F22).

A configuration manager (the NMT master, at boot-up) keeps for each node what it downloads to it: subindex n of 0x1F22 is the
concise DCF of node n, a DOMAIN. Little-endian:

    number of entries       UNSIGNED32
    then for each entry
      index                 UNSIGNED16
      subindex              UNSIGNED8
      size of the data      UNSIGNED32, bytes
      data                  as SDO carries it

The manager writes the entries in this order, so the order is part of the configuration; `download_order` makes one that devices
accept. An object may occur twice (a COB-ID: first invalid, later valid). Empty data, or 0 entries, configure nothing.

Source: CiA 302-3 v4.1.0, object 0x1F22.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Final

from canopen_proto.compiling import mypyc_attr
from canopen_proto.dictionary.download_order import Write
from canopen_proto.machine import LocalProtocolError

MAX_CONCISE: Final = 16 << 20
"""Bytes of one concise DCF: as much as one SDO transfer brings (sdo.client.MAX_UPLOAD)."""

_COUNT = struct.Struct("<I")
_ENTRY = struct.Struct("<HBI")


@mypyc_attr(native_class=False)
class ConciseError(LocalProtocolError, ValueError):
    """The bytes are not a valid concise DCF. offset: the first wrong byte. message: for people."""

    def __init__(self, message: str, offset: int) -> None:
        super().__init__(message)
        self.offset = offset


def pack_concise(entries: Iterable[Write]) -> bytes:
    """Return the concise DCF of these entries, in this order. Raises ConciseError for an index or subindex out of range, and for
    more than MAX_CONCISE bytes."""
    data = bytearray(_COUNT.size)
    count = 0
    for index, subindex, value in entries:
        if not (0 <= index <= 0xFFFF and 0 <= subindex <= 0xFF):
            raise ConciseError(f"entry {count + 1}: there is no object 0x{index:04X}:{subindex:02X}", len(data))
        data += _ENTRY.pack(index, subindex, len(value))
        data += value
        count += 1
        if len(data) > MAX_CONCISE:
            raise ConciseError(f"a concise DCF has at most {MAX_CONCISE} bytes; entry {count} ends beyond that", len(data))
    _COUNT.pack_into(data, 0, count)
    return bytes(data)


def from_concise(data: bytes) -> list[Write]:
    """Return the entries of a concise DCF in order; none for empty data.

    Raises ConciseError, which names the byte, if the data do not match the counts in them, or are longer than MAX_CONCISE. Time
    and memory depend on len(data) only, not on the counts.
    """
    if len(data) > MAX_CONCISE:
        raise ConciseError(f"a concise DCF has at most {MAX_CONCISE} bytes, not {len(data)}", MAX_CONCISE)
    if not data:
        return []
    if len(data) < _COUNT.size:
        raise ConciseError(f"a concise DCF begins with a count of {_COUNT.size} bytes; only {len(data)} bytes were given", 0)
    (count,) = _COUNT.unpack_from(data)
    entries: list[Write] = []
    at = _COUNT.size
    for number in range(1, count + 1):
        if len(data) - at < _ENTRY.size:
            raise ConciseError(f"byte {at}: {count} entries are announced, but the data end before entry {number}", at)
        index, subindex, size = _ENTRY.unpack_from(data, at)
        at += _ENTRY.size
        if len(data) - at < size:
            here = f"entry {number} (0x{index:04X}:{subindex:02X})"
            raise ConciseError(f"byte {at}: {here} announces {size} bytes; {len(data) - at} are left", at)
        entries.append((index, subindex, bytes(data[at : at + size])))
        at += size
    if at != len(data):
        raise ConciseError(f"byte {at}: {len(data) - at} more bytes follow the last of {count} entries", at)
    return entries
