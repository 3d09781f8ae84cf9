"""CAN frames as the core sees them, and the identifiers of the predefined connection set.

A transport carries `Frame`s: identifier, data, two flags. A frame is plain data and never changes, so it may be queued, compared
and shared freely. Classical CAN only: the transports refuse CAN FD.

Three numbers that are easily mixed up:

- CAN-ID        on the wire, 11 or 29 bits: `Frame.can_id`.
- COB-ID        in an object such as 0x1800:01: a CAN-ID with three flag bits above it (CiA 301 v4.2.0, 7.5.2.33).
- routing key   a CAN-ID with the frame's flags above it: `Frame.key`. Machines ask for these in `Machine.can_ids()`, and
                routing tables are made of them. For an ordinary 11-bit data frame it equals the CAN-ID. `RoutingKey` is a type
                of its own, so that mypy tells it from the other two; `routing_key` makes one.
"""

from __future__ import annotations

import re
from typing import Final, NewType

RoutingKey = NewType("RoutingKey", int)
"""A CAN-ID with the frame's flags above it; see this module's text."""

REMOTE: Final = 1
"""Frame flag: remote transmission request; the frame has no data, only a length."""
EXTENDED: Final = 2
"""Frame flag: 29-bit identifier."""

KEY_REMOTE: Final = REMOTE << 29
KEY_EXTENDED: Final = EXTENDED << 29

# COB-ID flag bits (CiA 301 v4.2.0, 7.5.2.33, and 7.5.2.5 for SYNC, 7.5.2.17 for EMCY)
COB_ID_INVALID: Final = 1 << 31
"""PDO, EMCY, SDO: not valid, so not used. (For SYNC and TIME, bits 30 and 31 have other meanings.)"""
COB_ID_NO_RTR: Final = 1 << 30
"""TPDO: remote requests are not answered. SYNC, TIME: the device produces it."""
COB_ID_EXTENDED: Final = 1 << 29
"""29-bit identifier."""

# Function codes of the predefined connection set, as the CAN-ID of node 0 (CiA 301 v4.2.0, 7.3.3, tables 36 and 37). To NMT, SYNC
# and TIME no node-ID is added: they are whole CAN-IDs, and so routing keys.
NMT: Final = RoutingKey(0x000)
SYNC: Final = RoutingKey(0x080)
EMCY: Final = 0x080
TIME: Final = RoutingKey(0x100)
TPDO1: Final = 0x180
RPDO1: Final = 0x200
TPDO2: Final = 0x280
RPDO2: Final = 0x300
TPDO3: Final = 0x380
RPDO3: Final = 0x400
TPDO4: Final = 0x480
RPDO4: Final = 0x500
SDO_SERVER_TO_CLIENT: Final = 0x580
SDO_CLIENT_TO_SERVER: Final = 0x600
ERROR_CONTROL: Final = 0x700

TPDOS: Final = (TPDO1, TPDO2, TPDO3, TPDO4)
BY_THE_NODE: Final = frozenset((EMCY, *TPDOS, SDO_SERVER_TO_CLIENT, ERROR_CONTROL))
"""The functions whose frames a node sends itself."""
FUNCTION: Final = 0x780
"""The bits of a CAN-ID that tell the function; the others are the node-ID."""

MAX_NODE_ID: Final = 127
ALL_NODE_IDS: Final = range(1, MAX_NODE_ID + 1)
UNCONFIGURED: Final = 0xFF
"""The node-ID of a device that has none."""

_CANDUMP: Final = r"\s*([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(?:[Rr]([0-8])?|((?:[0-9A-Fa-f]{2}(?:\.?[0-9A-Fa-f]{2}){0,7})?))\s*"


class Frame:
    """One classical CAN frame. Never change a frame.

    can_id: 0..0x7FF, or 0..0x1FFFFFFF with EXTENDED. data: 0 to 8 bytes; a remote frame has none. key: the routing key, the
    CAN-ID with the flags above it; kept, not computed, since each layer routes the frame once. The constructor does not check (it
    is in every hot path); `Frame.parse` and the transports do.
    """

    __slots__ = ("_asked", "can_id", "data", "flags", "key")

    def __init__(self, can_id: int, data: bytes = b"", flags: int = 0, dlc: int = 0) -> None:
        """dlc: how many bytes a remote frame asks for. That of a data frame is the length of its data, whatever is given here."""
        self.can_id = can_id
        self.data = data
        self.flags = flags
        # As `routing_key` does, without its call. Nearly every frame has no flags: a test costs less than a shift.
        if flags:
            self.key: RoutingKey = can_id | flags << 29  # type: ignore[assignment]
            self._asked = dlc
        else:
            self.key = can_id  # type: ignore[assignment]

    @property
    def dlc(self) -> int:
        """The length on the wire: of the data, or in a remote frame, how many bytes it asks for. 0..8 if the frame is valid."""
        return self._asked if self.flags & REMOTE else len(self.data)

    @classmethod
    def parse(cls, text: str) -> Frame:
        """Make a frame from candump's notation: "60C#4041600000000000", "705#R1", "18FF0001#", "123#11.22.33".

        Three identifier digits mean 11 bits, eight mean 29. Raises ValueError, which names the text; also for CAN FD ("##").
        """
        match = re.fullmatch(_CANDUMP, text)  # compiled when it is first needed, and kept by re
        if match is None:
            reason = "CAN FD is not supported" if "##" in text else "expected candump notation such as 60C#4041600000000000"
            raise ValueError(f"not a classical CAN frame: {text!r}: {reason}")
        identifier, remote_dlc, data = match.groups()
        can_id = int(identifier, 16)
        flags = EXTENDED if len(identifier) == 8 else 0
        if can_id > (0x1FFFFFFF if flags else 0x7FF):
            raise ValueError(f"not a classical CAN frame: {text!r}: identifier out of range")
        if data is None:
            return cls(can_id, b"", flags | REMOTE, int(remote_dlc or 0))
        return cls(can_id, bytes.fromhex(data.replace(".", "")), flags)

    def __str__(self) -> str:
        identifier = f"{self.can_id:08X}" if self.flags & EXTENDED else f"{self.can_id:03X}"
        if self.flags & REMOTE:
            return f"{identifier}#R{self.dlc or ''}"
        return f"{identifier}#{self.data.hex().upper()}"

    def __repr__(self) -> str:
        return f"<Frame {self}>"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Frame):
            return NotImplemented
        return (self.can_id, self.data, self.flags, self.dlc) == (other.can_id, other.data, other.flags, other.dlc)

    def __hash__(self) -> int:
        return hash((self.can_id, self.data, self.flags, self.dlc))


def routing_key(can_id: int, flags: int = 0) -> RoutingKey:
    """Return the routing key of frames with this CAN-ID and these flags (REMOTE, EXTENDED)."""
    return RoutingKey(can_id | flags << 29)


def key_of_cob_id(cob_id: int) -> RoutingKey:
    """Return the routing key of a COB-ID as in the dictionary: its CAN-ID, and EXTENDED if bit 29 is set."""
    if cob_id & COB_ID_EXTENDED:
        return routing_key(cob_id & 0x1FFFFFFF, EXTENDED)
    return routing_key(cob_id & 0x7FF)


def can_id_of(key: RoutingKey) -> int:
    """Return the CAN-ID in a routing key."""
    return key & 0x1FFFFFFF


def flags_of(key: RoutingKey) -> int:
    """Return the frame flags in a routing key."""
    return key >> 29


def frame_for_key(key: RoutingKey, data: bytes) -> Frame:
    """Return a data frame with the CAN-ID of a routing key."""
    if key & KEY_EXTENDED:
        return Frame(key & 0x1FFFFFFF, data, EXTENDED)
    return Frame(key, data)
