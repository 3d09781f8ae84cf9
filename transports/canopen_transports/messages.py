"""Convert between python-can's messages and our frames; only valid frames of classical CAN pass.

python-can checks neither direction, and its backends differ: a DLC above 8 with 8 bytes of data (legal on the wire), remote
frames with data, CAN FD, error frames. What CANopen cannot use is refused here with a reason, so that the core need not check
again.
"""

from __future__ import annotations

from typing import Final

import can

from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_transports.transport import MAX_EXTENDED_ID, MAX_LENGTH, MAX_STANDARD_ID

MAX_TIMESTAMP: Final = 1 << 33
"""Seconds: what 64 bits of ns hold in a log. A larger number is not a time stamp."""


class MessageRefusedError(ValueError):
    """A message that is not a classical CAN data or remote frame. The text is the reason."""


def frame_of(message: can.Message) -> Frame:
    """Return the frame in a received message. Raises MessageRefusedError. The caller must sort out error frames before."""
    if message.is_fd:
        raise MessageRefusedError("a CAN FD frame: CANopen runs on classical CAN")
    can_id, dlc = message.arbitration_id, message.dlc
    # The types are checked, too: udp_multicast passes on whatever was packed into a datagram.
    if not (isinstance(can_id, int) and isinstance(dlc, int) and isinstance(message.data, bytes | bytearray)):
        raise MessageRefusedError("its fields have the wrong types")
    flags = EXTENDED if message.is_extended_id else 0
    if not 0 <= can_id <= (MAX_EXTENDED_ID if flags else MAX_STANDARD_ID):
        raise MessageRefusedError(f"its CAN-ID 0x{can_id:X} is out of range")
    # In classical CAN a DLC of 9 to 15 means 8 bytes (ISO 11898-1); controllers report the DLC of the wire.
    if not 0 <= dlc <= 15:
        raise MessageRefusedError(f"its length {dlc} is out of range")
    length = min(dlc, MAX_LENGTH)
    if message.is_remote_frame:
        return Frame(can_id, b"", flags | REMOTE, length)
    if len(message.data) < length:
        raise MessageRefusedError(f"it announces {length} bytes and has {len(message.data)}")
    return Frame(can_id, bytes(message.data[:length]), flags)


def timestamp_of(message: can.Message) -> int | None:
    """Return a received message's time stamp in ns; None if the backend gave none, or an invalid one."""
    stamp = message.timestamp
    if not (isinstance(stamp, int | float) and 0 < stamp < MAX_TIMESTAMP):
        return None
    # A float of today's seconds is exact to 0.2 us. Whole seconds are converted apart, so that no more is lost.
    seconds, fraction = divmod(stamp, 1.0)
    return int(seconds) * 1_000_000_000 + round(fraction * 1e9)


def message_of(frame: Frame, channel: str | None = None) -> can.Message:
    """Return the message for a frame that has passed `check_frame`. channel: the bus's name in python-can, which files need."""
    return can.Message(
        arbitration_id=frame.can_id,
        is_extended_id=bool(frame.flags & EXTENDED),
        is_remote_frame=bool(frame.flags & REMOTE),
        dlc=frame.dlc,
        data=frame.data,
        channel=channel,
    )
