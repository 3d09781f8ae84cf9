"""The error codes of a CANopen gateway (CiA 309-1, 309-3), in words.

An answer has one of these where the gateway itself refuses or fails. An SDO abort code, with 8 hexadecimal digits, stands in the
same place where a node refuses. The numbers are those that CANopenNode and Lely CANopen have; the standard was not at hand.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class GatewayCode(IntEnum):
    """What a gateway refuses, and what it reports: its internal error codes."""

    NOT_SUPPORTED = 100
    SYNTAX = 101
    INTERNAL_STATE = 102
    TIME_OUT = 103
    NO_DEFAULT_NET = 104
    NO_DEFAULT_NODE = 105
    UNSUPPORTED_NET = 106
    UNSUPPORTED_NODE = 107
    GUARDING_LOST = 200
    CONNECTION_LOST = 201
    HEARTBEAT_STARTED = 202
    HEARTBEAT_LOST = 203
    WRONG_NMT_STATE = 204
    BOOT_UP = 205
    ERROR_PASSIVE = 300
    BUS_OFF = 301
    OVERFLOW = 303
    CAN_INIT = 304
    CAN_ACTIVE = 305
    PDO_IN_USE = 400
    PDO_LENGTH = 401
    LSS_MAKER = 501
    LSS_NODE_ID = 502
    LSS_BIT_RATE = 503
    LSS_STORE = 504
    LSS_MEDIA = 505
    OUT_OF_MEMORY = 600


_TEXTS: Final[dict[int, str]] = {
    GatewayCode.NOT_SUPPORTED: "Request not supported.",
    GatewayCode.SYNTAX: "Syntax error.",
    GatewayCode.INTERNAL_STATE: "Request not processed due to internal state.",
    GatewayCode.TIME_OUT: "Time-out.",
    GatewayCode.NO_DEFAULT_NET: "No default net set.",
    GatewayCode.NO_DEFAULT_NODE: "No default node set.",
    GatewayCode.UNSUPPORTED_NET: "Unsupported net.",
    GatewayCode.UNSUPPORTED_NODE: "Unsupported node.",
    GatewayCode.GUARDING_LOST: "Lost guarding message.",
    GatewayCode.CONNECTION_LOST: "Lost connection.",
    GatewayCode.HEARTBEAT_STARTED: "Heartbeat started.",
    GatewayCode.HEARTBEAT_LOST: "Heartbeat lost.",
    GatewayCode.WRONG_NMT_STATE: "Wrong NMT state.",
    GatewayCode.BOOT_UP: "Boot-up.",
    GatewayCode.ERROR_PASSIVE: "Error passive.",
    GatewayCode.BUS_OFF: "Bus off.",
    GatewayCode.OVERFLOW: "CAN buffer overflow.",
    GatewayCode.CAN_INIT: "CAN init.",
    GatewayCode.CAN_ACTIVE: "CAN active.",
    GatewayCode.PDO_IN_USE: "PDO already used.",
    GatewayCode.PDO_LENGTH: "PDO length exceeded.",
    GatewayCode.LSS_MAKER: "LSS error of the implementation or the manufacturer.",
    GatewayCode.LSS_NODE_ID: "LSS node-ID not supported.",
    GatewayCode.LSS_BIT_RATE: "LSS bit rate not supported.",
    GatewayCode.LSS_STORE: "LSS parameter storing failed.",
    GatewayCode.LSS_MEDIA: "LSS command failed because of a media error.",
    GatewayCode.OUT_OF_MEMORY: "Running out of memory.",
}


def code_text(code: int) -> str:
    """Return an internal error code in words: a sentence. code: also one that this gateway does not know."""
    return _TEXTS.get(code, f"Error {code}.")
