"""Cyclic frames that the kernel sends by itself (CAN_BCM, the broadcast manager).

A timer of the kernel keeps the period to some 10 us, however late our process is: the steadiest SYNC of a computer without
special hardware. Its cost: the process learns of a SYNC only by receiving it, so a set-point follows with the delay of a wake-up.
And the kernel does not report a frame that did not get out (interface down, queue full).

Several frames are sent in turn, one each period, then again from the first: a SYNC with a counter (0x1019) is such a series.

The frames go out by another socket than the transport's, so that the transport receives them, with time stamps. When the process
ends, in whatever way, the kernel stops sending.
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
_PADDING: Final = bytes(-_HEAD.size % 8)  # the frames after it are aligned

MIN_PERIOD: Final = 1_000
"""ns: the broadcast manager counts in microseconds."""


def check_cyclic(frames: Sequence[Frame], period: int) -> None:
    """Raise ValueError unless the kernel can send these frames in turn, one each `period`: 1 to 256 frames, 1,000 ns or
    more, of which the kernel leaves out the part below 1 us."""
    if not 1 <= len(frames) <= MAX_CYCLIC_FRAMES:
        raise ValueError(f"the kernel sends 1 to {MAX_CYCLIC_FRAMES} frames in turn, not {len(frames)}")
    if period < MIN_PERIOD:
        raise ValueError(f"the kernel's shortest period is 1 us, not {period} ns")
    for frame in frames:
        check_frame(frame)


class Broadcast:
    """Lets the kernel send frames on one interface until it is closed: the first frame now, then one each `period`."""

    def __init__(self, interface: str, frames: Sequence[Frame], period: int) -> None:
        """interface: its name, such as "can0". frames, period: as for `check_cyclic`. Raises OSError as the kernel does."""
        name = frames[0].can_id | frames[0].flags << 30  # names the job to the kernel; each frame has its own identifier
        seconds, microseconds = divmod(period // 1000, 1_000_000)
        flags = socket.CAN_BCM_SETTIMER | socket.CAN_BCM_STARTTIMER
        head = _HEAD.pack(socket.CAN_BCM_TX_SETUP, flags, 0, 0, 0, seconds, microseconds, name, len(frames))
        self._interface = interface
        self._order = head + _PADDING + b"".join(map(pack, frames))
        self._socket = self._begun()

    def restart(self) -> None:
        """Start again on a new interface of the same name: the kernel keeps the job on the interface that is gone. Raises
        OSError."""
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
