"""The bit rate of a CAN interface, as the kernel tells it by rtnetlink.

    request   nlmsghdr, ifinfomsg with the number of the interface    RTM_GETLINK
    answer    nlmsghdr, ifinfomsg, attributes                         RTM_NEWLINK

An attribute has its length (with these four bytes), its type, its data, and padding to four bytes. Within each other lie
IFLA_LINKINFO, IFLA_INFO_DATA, IFLA_CAN_BITTIMING: a struct can_bittiming, which begins with the bit rate.

Sources: linux/netlink.h, rtnetlink.h, if_link.h, can/netlink.h.
"""

from __future__ import annotations

import socket
import struct
from typing import Final

_HEADER: Final = struct.Struct("=IHHII")  # length, type, flags, sequence number, port
_LINK: Final = struct.Struct("=BxHiII")  # family, device type, number, flags, change mask
_ATTRIBUTE: Final = struct.Struct("=HH")  # length, type
_BITRATE: Final = struct.Struct("=I")
_NEW_LINK: Final = 16
_GET_LINK: Final = 18
_REQUEST: Final = 1
_TYPE: Final = 0x3FFF  # without the flags "nested" and "byte order"
_LINK_INFO, _INFO_DATA, _BIT_TIMING = 18, 2, 1
_ANSWER_TIME: Final = 0.1
"""Seconds. The kernel answers within `send`."""
_LARGEST: Final = 1 << 16


def bitrate_of(interface: str) -> int | None:
    """Return the bit rate of an interface in bit/s; None if the kernel does not tell one, as of a virtual CAN bus."""
    try:
        request = _LINK.pack(socket.AF_UNSPEC, 0, socket.if_nametoindex(interface), 0, 0)
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as kernel:
            kernel.settimeout(_ANSWER_TIME)
            kernel.send(_HEADER.pack(_HEADER.size + len(request), _GET_LINK, _REQUEST, 1, 0) + request)
            return bitrate_in(kernel.recv(_LARGEST))
    except OSError:
        return None


def bitrate_in(answer: bytes) -> int | None:
    """Return the bit rate in the kernel's answer about an interface; None if there is none."""
    if len(answer) < _HEADER.size or _HEADER.unpack_from(answer)[1] != _NEW_LINK:
        return None
    found = answer[_HEADER.size + _LINK.size :]
    for kind in (_LINK_INFO, _INFO_DATA, _BIT_TIMING):
        found = attributes(found).get(kind, b"")
    return _BITRATE.unpack_from(found)[0] or None if len(found) >= _BITRATE.size else None


def attributes(data: bytes) -> dict[int, bytes]:
    """Return the attributes in a row, by type. data: of a netlink message."""
    found = {}
    place = 0
    while place + _ATTRIBUTE.size <= len(data):
        length, kind = _ATTRIBUTE.unpack_from(data, place)
        if length < _ATTRIBUTE.size:
            break
        found[kind & _TYPE] = data[place + _ATTRIBUTE.size : place + length]
        place += length + 3 & ~3
    return found
