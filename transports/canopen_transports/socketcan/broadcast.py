"""Cyclic frames that the kernel sends by itself (CAN_BCM, the broadcast manager).

It keeps a period by a timer of its own, to some 10 us, however late our process is: the steadiest SYNC that a computer without
special hardware has. What it costs: the process learns of a SYNC only by receiving it, so a set-point comes behind it with the
delay of a wake; and the kernel tells nobody when a frame did not get out (interface down, queue full).

Several frames are sent in turn, one per period, then again from the first: a SYNC with a counter (0x1019) is that.

The frames are sent by a socket other than the transport's, so that the transport receives them, with their time stamps. When the
process ends, however it ends, the kernel sends no more.
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


class Broadcast:
    """The kernel's cyclic sender on one interface, for one sequence of frames at a time. Raises OSError as the kernel does."""

    def __init__(self, interface: str) -> None:
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_DGRAM, socket.CAN_BCM)
        self._running: int | None = None  # the identifier under which the kernel holds it
        try:
            self._socket.setblocking(False)
            self._socket.connect((interface,))
        except BaseException:
            self._socket.close()
            raise

    def start(self, frames: Sequence[Frame], period: int) -> None:
        """Send the first frame now, and one more each `period` (ns, from 1 us), in turn. What runs begins anew.

        frames: 1 to 256. ValueError for others, for a period that is too short, and for what classical CAN cannot carry.
        """
        if not 1 <= len(frames) <= MAX_CYCLIC_FRAMES:
            raise ValueError(f"the kernel sends 1 to {MAX_CYCLIC_FRAMES} frames in turn, not {len(frames)}")
        if period < MIN_PERIOD:
            raise ValueError(f"the kernel's shortest period is 1 us, not {period} ns")
        for frame in frames:
            check_frame(frame)
        self.stop()
        name = frames[0].can_id | frames[0].flags << 30
        seconds, microseconds = divmod(period // 1000, 1_000_000)
        flags = socket.CAN_BCM_SETTIMER | socket.CAN_BCM_STARTTIMER
        head = _HEAD.pack(socket.CAN_BCM_TX_SETUP, flags, 0, 0, 0, seconds, microseconds, name, len(frames))
        self._socket.send(head + _PADDING + b"".join(map(pack, frames)))
        self._running = name

    def stop(self) -> None:
        """Send no more. Does nothing where nothing runs."""
        if self._running is not None:
            name, self._running = self._running, None
            self._socket.send(_HEAD.pack(socket.CAN_BCM_TX_DELETE, 0, 0, 0, 0, 0, 0, name, 0) + _PADDING)

    def close(self) -> None:
        """Send no more, and leave the interface."""
        self._running = None
        self._socket.close()
