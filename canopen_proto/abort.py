"""SDO abort codes and their texts: the table of the "SDO abort transfer" protocol.

Either side may end a transfer with one frame that carries the mux and one of these codes; it is not answered (CiA 301 v4.2.0,
7.2.4.3.17, table 22). Device profiles and makers may use further codes. So a code from a peer stays a plain number, and `text_of`
has a text for every number.
"""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import Final


class AbortCode(IntEnum):
    """The abort codes of CiA 301 v4.2.0, table 22."""

    TOGGLE_NOT_ALTERNATED = 0x05030000
    TIMED_OUT = 0x05040000
    INVALID_COMMAND = 0x05040001
    INVALID_BLOCK_SIZE = 0x05040002
    INVALID_SEQUENCE_NUMBER = 0x05040003
    CRC_ERROR = 0x05040004
    OUT_OF_MEMORY = 0x05040005
    UNSUPPORTED_ACCESS = 0x06010000
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_SUCH_OBJECT = 0x06020000
    CANNOT_BE_MAPPED = 0x06040041
    PDO_LENGTH_EXCEEDED = 0x06040042
    PARAMETER_INCOMPATIBLE = 0x06040043
    INTERNAL_INCOMPATIBILITY = 0x06040047
    HARDWARE_ERROR = 0x06060000
    LENGTH_MISMATCH = 0x06070010
    LENGTH_TOO_HIGH = 0x06070012
    LENGTH_TOO_LOW = 0x06070013
    NO_SUCH_SUBINDEX = 0x06090011
    INVALID_VALUE = 0x06090030
    VALUE_TOO_HIGH = 0x06090031
    VALUE_TOO_LOW = 0x06090032
    MAXIMUM_BELOW_MINIMUM = 0x06090036
    NO_SDO_CONNECTION = 0x060A0023
    GENERAL_ERROR = 0x08000000
    CANNOT_TRANSFER = 0x08000020
    LOCAL_CONTROL = 0x08000021
    DEVICE_STATE = 0x08000022
    NO_OBJECT_DICTIONARY = 0x08000023
    NO_DATA = 0x08000024


class AbortOrigin(Enum):
    """The side that ended a transfer, and why."""

    PEER = "peer"
    """The other side sent an abort."""
    TIMEOUT = "timeout"
    """The other side fell silent (or our host, if it was the host's turn); we sent an abort."""
    LOCAL = "local"
    """We found a fault in a frame of the other side, or refused the transfer, and sent an abort."""
    CANCELLED = "cancelled"
    """Our own caller cancelled it; an abort was sent if the transfer had begun."""
    CONTESTED = "contested"
    """Client only: another client used the same SDO channel, so what the server did cannot be known."""
    REPLACED = "replaced"
    """Server only: the client began another transfer instead. No abort was exchanged."""


_TEXTS: Final[dict[int, str]] = {
    AbortCode.TOGGLE_NOT_ALTERNATED: "toggle bit not alternated",
    AbortCode.TIMED_OUT: "SDO protocol timed out",
    AbortCode.INVALID_COMMAND: "client/server command specifier not valid or unknown",
    AbortCode.INVALID_BLOCK_SIZE: "invalid block size",
    AbortCode.INVALID_SEQUENCE_NUMBER: "invalid sequence number",
    AbortCode.CRC_ERROR: "CRC error",
    AbortCode.OUT_OF_MEMORY: "out of memory",
    AbortCode.UNSUPPORTED_ACCESS: "unsupported access to an object",
    AbortCode.WRITE_ONLY: "attempt to read a write-only object",
    AbortCode.READ_ONLY: "attempt to write a read-only object",
    AbortCode.NO_SUCH_OBJECT: "object does not exist in the object dictionary",
    AbortCode.CANNOT_BE_MAPPED: "object cannot be mapped to the PDO",
    AbortCode.PDO_LENGTH_EXCEEDED: "number and length of the objects to be mapped would exceed the PDO length",
    AbortCode.PARAMETER_INCOMPATIBLE: "general parameter incompatibility",
    AbortCode.INTERNAL_INCOMPATIBILITY: "general internal incompatibility in the device",
    AbortCode.HARDWARE_ERROR: "access failed due to a hardware error",
    AbortCode.LENGTH_MISMATCH: "data type does not match, length of service parameter does not match",
    AbortCode.LENGTH_TOO_HIGH: "data type does not match, length of service parameter too high",
    AbortCode.LENGTH_TOO_LOW: "data type does not match, length of service parameter too low",
    AbortCode.NO_SUCH_SUBINDEX: "subindex does not exist",
    AbortCode.INVALID_VALUE: "invalid value for parameter",
    AbortCode.VALUE_TOO_HIGH: "value of parameter written too high",
    AbortCode.VALUE_TOO_LOW: "value of parameter written too low",
    AbortCode.MAXIMUM_BELOW_MINIMUM: "maximum value is less than minimum value",
    AbortCode.NO_SDO_CONNECTION: "resource not available: SDO connection",
    AbortCode.GENERAL_ERROR: "general error",
    AbortCode.CANNOT_TRANSFER: "data cannot be transferred or stored to the application",
    AbortCode.LOCAL_CONTROL: "data cannot be transferred or stored to the application because of local control",
    AbortCode.DEVICE_STATE: "data cannot be transferred or stored to the application because of the present device state",
    AbortCode.NO_OBJECT_DICTIONARY: "no object dictionary is present, or its dynamic generation failed",
    AbortCode.NO_DATA: "no data available",
}

_CLASSES: Final[dict[int, str]] = {
    0x05: "service error",
    0x06: "access error",
    0x08: "other error",
}


def text_of(code: int) -> str:
    """Return an abort code in words. For a code beyond table 22, these are its error class, if that is known, and the number."""
    text = _TEXTS.get(code)
    if text is None:
        text = f"{_CLASSES.get(code >> 24, 'error')} outside of CiA 301 (0x{code:08X})"
    return text
