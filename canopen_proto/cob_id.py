"""The rules for the COB-IDs of communication objects: PDOs, SDO channels, SYNC, EMCY and TIME.

The table of restricted CAN-IDs is in CiA 301 v4.2.0, 7.3.5, table 40. Each check returns None, or the abort code with which a
device refuses the value.
"""

from __future__ import annotations

from collections.abc import Container
from typing import Final

from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.frame import (
    COB_ID_EXTENDED,
    COB_ID_INVALID,
    EMCY,
    MAX_NODE_ID,
    SDO_CLIENT_TO_SERVER,
    SDO_SERVER_TO_CLIENT,
    SYNC,
    TIME,
)

RESTRICTED_CAN_IDS: Final = (
    range(0x080),  # NMT; reserved
    range(0x101, 0x181),  # reserved
    range(0x581, 0x600),  # default SDO, server to client
    range(0x601, 0x680),  # default SDO, client to server
    range(0x6E0, 0x700),  # reserved
    range(0x701, 0x780),  # NMT error control
    range(0x780, 0x800),  # reserved
)
"""CAN-IDs that no configurable communication object may take (CiA 301 v4.2.0, 7.3.5, table 40)."""

PRODUCES: Final = 1 << 30
"""COB-ID SYNC and TIME: the device produces it. CiA 301 v4.2.0, 7.5.2.5 and 7.5.2.15."""
CONSUMES: Final = 1 << 31
"""COB-ID TIME: the device consumes it. CiA 301 v4.2.0, 7.5.2.15."""
CAN_ID_AND_FRAME: Final = 0x3FFF_FFFF
"""Bits 0 to 29 of a COB-ID, which may change only while it is not in use."""

_FIXED: Final = {indices.COB_ID_SYNC: int(SYNC), indices.COB_ID_TIME_STAMP: int(TIME)}
_WITH_NODE_ID: Final = {
    (indices.COB_ID_EMERGENCY, 0): int(EMCY),
    (indices.SDO_SERVER_PARAMETER, 1): int(SDO_CLIENT_TO_SERVER),
    (indices.SDO_SERVER_PARAMETER, 2): int(SDO_SERVER_TO_CLIENT),
}


def cob_id_without_value(index: int, subindex: int, node_id: int) -> int | None:
    """Return the COB-ID of a communication object whose file gives it no value; None if the object holds no COB-ID.

    SYNC, TIME, EMCY and the default SDO channel have the CAN-ID of the predefined connection set. All others are not valid (bit
    31). It is never 0: that is the CAN-ID of NMT. Source: CiA 301 v4.2.0, 7.3.5 and 7.5.2.
    """
    base = _WITH_NODE_ID.get((index, subindex))
    if base is not None:
        return base + node_id
    if subindex == 0:
        return _FIXED.get(index)
    if index in indices.RPDO_COMMUNICATION or index in indices.TPDO_COMMUNICATION:
        return COB_ID_INVALID if subindex == 1 else None
    if index in indices.SDO_SERVERS or index in indices.SDO_CLIENTS:
        return COB_ID_INVALID if subindex in (1, 2) else None
    return COB_ID_INVALID if index == indices.EMERGENCY_CONSUMER and subindex <= MAX_NODE_ID else None


def check_can_id(cob_id: int) -> AbortCode | None:
    """Return 0x06090030 if the CAN-ID in a COB-ID is restricted or out of range, else None. CiA 301 v4.2.0, 7.3.5"""
    if cob_id & COB_ID_EXTENDED:
        return None
    can_id = cob_id & 0x1FFF_FFFF
    restricted = can_id > 0x7FF or any(can_id in each for each in RESTRICTED_CAN_IDS)
    return AbortCode.INVALID_VALUE if restricted else None


def check_cob_id(cob_id: int, present: int, *, in_use: bool, allowed: Container[int] = ()) -> AbortCode | None:
    """Return the abort code if a COB-ID may not replace the present one, else None.

    in_use: the present COB-ID is valid, so its CAN-ID may not change. allowed: restricted CAN-IDs that this object may have.
    """
    refusal = None if cob_id & CAN_ID_AND_FRAME in allowed else check_can_id(cob_id)
    if refusal is None and in_use and (cob_id ^ present) & CAN_ID_AND_FRAME:
        return AbortCode.DEVICE_STATE
    return refusal


def is_valid(cob_id: int) -> bool:
    """Return whether a COB-ID (not a PDO's) is in use. 0, which only NMT can have, counts as not valid."""
    return cob_id != 0 and not cob_id & COB_ID_INVALID
