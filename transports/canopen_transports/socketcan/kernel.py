"""The kernel's constants and structures (linux/can.h, can/raw.h, can/bcm.h, if.h) that Python's `socket` does not have.

Their values hold on all architectures on which Linux runs CAN today, except the socket options of PA-RISC and SPARC.
"""

from __future__ import annotations

import socket
import struct
from pathlib import Path
from typing import Final

from canopen_proto.frame import KEY_EXTENDED, Frame, RoutingKey

SO_RCVBUFFORCE: Final = 33
SO_TIMESTAMPNS: Final = 35
SO_RXQ_OVFL: Final = 40
SO_MEMINFO: Final = 55
MEMINFO: Final = struct.Struct("9I")
"""The result of SO_MEMINFO; the last counter is that of the frames that the socket dropped."""

CAN_RAW_ERR_FILTER: Final = 2  # not in every Python
MAX_FILTERS: Final = 512
"""CAN_RAW_FILTER_MAX."""
MAX_CYCLIC_FRAMES: Final = 256
"""MAX_NFRAMES of the broadcast manager."""

ERROR_FRAME: Final = 0x20000000
"""CAN_ERR_FLAG, which Python's `socket` has on Linux only: this module is imported elsewhere, too."""
ALL_ERRORS: Final = 0x1FFFFFFF
"""CAN_ERR_MASK."""

CAN_FRAME: Final = struct.Struct("=IB3x8s")
"""struct can_frame: CAN-ID with its flags, length, padding, data."""
CAN_FILTER: Final = struct.Struct("=II")

_SIOCGIFFLAGS: Final = 0x8913
_IFF_UP: Final = 1
_IFREQ: Final = struct.Struct("16sH22x")


def pack(frame: Frame) -> bytes:
    """Return a frame in the kernel's form, with REMOTE and EXTENDED as bits 30 and 31."""
    return CAN_FRAME.pack(frame.can_id | frame.flags << 30, frame.dlc, frame.data)


def filter_for(key: RoutingKey) -> bytes:
    """Return the kernel's filter for the frames of one routing key: this CAN-ID, 11 or 29 bits, data or remote."""
    number = socket.CAN_EFF_MASK if key & KEY_EXTENDED else socket.CAN_SFF_MASK
    flags = (key & ~socket.CAN_EFF_MASK) << 1
    return CAN_FILTER.pack(key & number | flags, number | socket.CAN_EFF_FLAG | socket.CAN_RTR_FLAG)


def is_up(sock: socket.socket, interface: str) -> bool | None:
    """Return whether a network interface is up; None if there is none of that name."""
    import fcntl  # not on Windows, where this module is imported too

    try:
        answer = fcntl.ioctl(sock.fileno(), _SIOCGIFFLAGS, _IFREQ.pack(interface.encode(), 0))
    except OSError:
        return None
    return bool(_IFREQ.unpack(answer)[1] & _IFF_UP)


def has_carrier(interface: str) -> bool | None:
    """Return whether an interface that is up has a carrier: its controller is not bus-off. None if the system does not tell."""
    try:
        return Path("/sys/class/net", interface, "carrier").read_text() == "1\n"
    except OSError:
        return None
