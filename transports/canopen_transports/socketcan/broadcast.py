"""Cyclic frames that the kernel sends by itself (CAN_BCM, the broadcast manager).

It keeps a period by a timer of its own, to some 10 us, however late our process is: the steadiest SYNC that a computer without
special hardware has. What it costs: the process learns of a SYNC only by receiving it, so a set-point comes behind it with the
delay of a wake; and the kernel tells nobody when a frame did not get out (interface down, queue full).

Several frames are sent in turn, one per period, then again from the first: a SYNC with a counter (0x1019) is that.

The frames are sent by a socket other than the transport's, so that the transport receives them, with their time stamps. When the
process ends, however it ends, the kernel stops sending.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Sequence
from typing import Final

from canopen_proto.frame import Frame
from canopen_transports.socketcan.kernel import MAX_CYCLIC_FRAMES, pack
from canopen_transports.transport import check_frame

# struct bcm_msg_head: opcode, flags, count, two intervals as seconds and microseconds, CAN-ID, number of frames
_HEAD: Final = struct.Struct("@3I4l2I")
_PADDING: Final = bytes(-_HEAD.size % 8)  # the frames behind it are aligned

MIN_PERIOD: Final = 1_000
"""ns: the broadcast manager counts in microseconds."""


def check_cyclic(frames: Sequence[Frame], period: int) -> None:
    """ValueError unless the kernel can send these frames in turn, one each `period` (ns): 1 to 256 frames, from 1 us."""
    if not 1 <= len(frames) <= MAX_CYCLIC_FRAMES:
        raise ValueError(f"the kernel sends 1 to {MAX_CYCLIC_FRAMES} frames in turn, not {len(frames)}")
    if period < MIN_PERIOD:
        raise ValueError(f"the kernel's shortest period is 1 us, not {period} ns")
    for frame in frames:
        check_frame(frame)


class Broadcast:
    """The kernel sends these frames on one interface, the first one now and one more each `period`, until it is closed."""

    def __init__(self, interface: str, frames: Sequence[Frame], period: int) -> None:
        """frames, period: as `check_cyclic` has them. Raises OSError as the kernel does."""
        name = frames[0].can_id | frames[0].flags << 30  # under which the kernel holds it; each frame has its own identifier
        seconds, microseconds = divmod(period // 1000, 1_000_000)
        flags = socket.CAN_BCM_SETTIMER | socket.CAN_BCM_STARTTIMER
        head = _HEAD.pack(socket.CAN_BCM_TX_SETUP, flags, 0, 0, 0, seconds, microseconds, name, len(frames))
        self._interface = interface
        self._order = head + _PADDING + b"".join(map(pack, frames))
        self._socket = self._begun()

    def restart(self) -> None:
        """Begin again, on a new interface of that name: the kernel goes on with the one that is gone. Raises OSError."""
        self._socket.close()
        self._socket = self._begun()

    def _begun(self) -> socket.socket:
        sock = socket.socket(socket.AF_CAN, socket.SOCK_DGRAM, socket.CAN_BCM)
        try:
            sock.setblocking(False)
            sock.connect((self._interface,))
            sock.send(self._order)
        except BaseException:
            sock.close()
            raise
        return sock

    def close(self) -> None:
        """Stop sending, and leave the interface."""
        self._socket.close()
