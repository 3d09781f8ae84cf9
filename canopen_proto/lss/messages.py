"""The messages of the layer setting services (CiA 305), as both roles need them.

The master sends on 0x7E5, the slaves on 0x7E4, always eight bytes: a command specifier, then its data, little-endian, and zeros.
No frame has a node-ID: a device is selected by its LSS address, the four numbers of its identity object (0x1018:01 to :04).

The tables of services, errors and bit timings are those of CiA 305 as Lely CANopen, CANopenNode and makers' manuals have them;
the standard itself was not at hand.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Final, NamedTuple

from canopen_proto.frame import MAX_NODE_ID, Frame, RoutingKey
from canopen_proto.frame import UNCONFIGURED as UNCONFIGURED
from canopen_proto.machine import LocalProtocolError

FROM_SLAVE: Final = RoutingKey(0x7E4)
FROM_MASTER: Final = RoutingKey(0x7E5)
LENGTH: Final = 8

OK: Final = 0
SPECIFIC: Final = 0xFF
"""Error byte: the maker's own error, which the byte behind it tells."""


class LssState(IntEnum):
    """The states of a slave, by their number in "switch state global"."""

    WAITING = 0
    CONFIGURATION = 1


class LssService(IntEnum):
    """The command specifiers. An answer has that of its request, unless it has one of its own (SELECTED, IDENTIFIED,
    NON_CONFIGURED)."""

    SWITCH_GLOBAL = 0x04
    CONFIGURE_NODE_ID = 0x11
    CONFIGURE_BIT_TIMING = 0x13
    ACTIVATE_BIT_TIMING = 0x15
    STORE = 0x17
    SELECT_VENDOR = 0x40
    SELECT_PRODUCT = 0x41
    SELECT_REVISION = 0x42
    SELECT_SERIAL = 0x43
    SELECTED = 0x44
    IDENTIFY_VENDOR = 0x46
    IDENTIFY_PRODUCT = 0x47
    IDENTIFY_REVISION_LOW = 0x48
    IDENTIFY_REVISION_HIGH = 0x49
    IDENTIFY_SERIAL_LOW = 0x4A
    IDENTIFY_SERIAL_HIGH = 0x4B
    IDENTIFY_NON_CONFIGURED = 0x4C
    IDENTIFIED = 0x4F
    NON_CONFIGURED = 0x50
    FASTSCAN = 0x51
    INQUIRE_VENDOR = 0x5A
    INQUIRE_PRODUCT = 0x5B
    INQUIRE_REVISION = 0x5C
    INQUIRE_SERIAL = 0x5D
    INQUIRE_NODE_ID = 0x5E


SELECT: Final = (LssService.SELECT_VENDOR, LssService.SELECT_PRODUCT, LssService.SELECT_REVISION, LssService.SELECT_SERIAL)
"""The messages that select a slave, in the order in which they are sent."""

IDENTIFY: Final = (
    LssService.IDENTIFY_VENDOR,
    LssService.IDENTIFY_PRODUCT,
    LssService.IDENTIFY_REVISION_LOW,
    LssService.IDENTIFY_REVISION_HIGH,
    LssService.IDENTIFY_SERIAL_LOW,
    LssService.IDENTIFY_SERIAL_HIGH,
)
"""The messages that ask whether a slave is there, in the order in which they are sent."""

INQUIRE: Final = (
    LssService.INQUIRE_VENDOR,
    LssService.INQUIRE_PRODUCT,
    LssService.INQUIRE_REVISION,
    LssService.INQUIRE_SERIAL,
)
"""The messages that ask a selected slave for the numbers of its address, in their order."""

_WAITING: Final = frozenset({LssState.WAITING})
_CONFIGURATION: Final = frozenset({LssState.CONFIGURATION})
_BOTH: Final = _WAITING | _CONFIGURATION

STATES: Final[Mapping[LssService, frozenset[LssState]]] = MappingProxyType(
    {
        LssService.SWITCH_GLOBAL: _BOTH,
        **dict.fromkeys(SELECT, _WAITING),
        LssService.CONFIGURE_NODE_ID: _CONFIGURATION,
        LssService.CONFIGURE_BIT_TIMING: _CONFIGURATION,
        LssService.ACTIVATE_BIT_TIMING: _CONFIGURATION,
        LssService.STORE: _CONFIGURATION,
        **dict.fromkeys((*IDENTIFY, LssService.IDENTIFY_NON_CONFIGURED), _BOTH),
        LssService.FASTSCAN: _WAITING,
        **dict.fromkeys((*INQUIRE, LssService.INQUIRE_NODE_ID), _CONFIGURATION),
    }
)
"""Request -> the states in which a slave takes it. In the other state, and for other command specifiers, it is silent."""

SERVICE_OF_BYTE: Final = {int(service): service for service in LssService}

CIA_TABLE: Final = 0
"""The selector of CiA's table of bit timings. 1..127 are reserved, 128..255 are the maker's own."""
BIT_RATES: Final[Mapping[int, int]] = MappingProxyType({0: 1000, 1: 800, 2: 500, 3: 250, 4: 125, 6: 50, 7: 20, 8: 10})
"""Index in CiA's table -> kbit/s. 5 is reserved (100 kbit/s in old devices), 9 means automatic detection."""
AUTOMATIC: Final = 9

CONFIRM: Final = 0x80
"""The "bit check" of the first fastscan frame: each slave without a node-ID answers, and its position is the vendor-ID again."""
MAX_BIT_CHECK: Final = 31

_U32: Final = struct.Struct("<I")
_FASTSCAN: Final = struct.Struct("<BIBBB")


class LssAddress(NamedTuple):
    """The address of a device: 0x1018:01 to :04, each 0..0xFFFF_FFFF. A number that the device lacks counts as 0."""

    vendor_id: int
    product_code: int
    revision: int
    serial: int

    def __str__(self) -> str:
        return " ".join(f"{number:08X}" for number in self)


class LssConfiguration(NamedTuple):
    """What LSS sets in a device. node_id: 1..127, or UNCONFIGURED. bit_rate: kbit/s, 0 if the device does not know it."""

    node_id: int = UNCONFIGURED
    bit_rate: int = 0


FIELD_NAMES: Final = ("vendor-ID", "product code", "revision", "serial number")
"""The numbers of an address, in their order."""

_OWN_ERRORS: Final[Mapping[LssService, Mapping[int, str]]] = {
    LssService.CONFIGURE_NODE_ID: {1: "node-ID out of range"},
    LssService.CONFIGURE_BIT_TIMING: {1: "bit timing not supported"},
    LssService.STORE: {1: "storing not supported", 2: "access to the storage failed"},
}


def error_text(service: LssService, error: int, specific: int) -> str:
    """Return the error of an answer to 0x11, 0x13 or 0x17 in words; "" if it is no error. service: that of the answer. error: its
    error code, 0..255. specific: the maker's own code, 0..255, which counts with 255."""
    if error == OK:
        return ""
    if error == SPECIFIC:
        return f"the maker's own error {specific}"
    return _OWN_ERRORS.get(service, {}).get(error, f"error {error}")


def message(service: LssService, data: bytes = b"") -> bytes:
    """Return the eight bytes of a message. data: what follows the command specifier, 7 bytes at most."""
    return (bytes((service,)) + data).ljust(LENGTH, b"\0")


def number_message(service: LssService, number: int) -> bytes:
    """Return a message with one UNSIGNED32. Raises LocalProtocolError if it is none."""
    if not 0 <= number <= 0xFFFF_FFFF:
        raise LocalProtocolError(f"LSS {service.name}: {number} is outside 0..0xFFFFFFFF")
    return message(service, _U32.pack(number))


def number_of(data: bytes) -> int:
    """Return the UNSIGNED32 behind the command specifier."""
    return int.from_bytes(data[1:5], "little")


def fastscan_message(number: int, bit_check: int, sub: int, following: int) -> bytes:
    """Return a fastscan request. See LssMaster.fastscan."""
    return _FASTSCAN.pack(LssService.FASTSCAN, number, bit_check, sub, following)


def fastscan_of(data: bytes) -> tuple[int, int, int, int]:
    """Return what `fastscan_message` was made of: number, bit_check, sub, following. data: eight bytes."""
    _, number, bit_check, sub, following = _FASTSCAN.unpack(data)
    return number, bit_check, sub, following


def field_name(sub: int) -> str:
    """Return the name of a number of an address: "vendor-ID". sub: 0..3."""
    return FIELD_NAMES[sub] if sub < len(FIELD_NAMES) else f"part {sub}"


def is_node_id(number: int) -> bool:
    """Return whether a number is one that a device may be given: 1..127, or UNCONFIGURED."""
    return 1 <= number <= MAX_NODE_ID or number == UNCONFIGURED


# ---- in words ----


def text_of(frame: Frame) -> str:
    """Return an LSS frame in words, for people who read a recording."""
    data, by_master = frame.data, frame.key == FROM_MASTER
    service = SERVICE_OF_BYTE.get(data[0]) if data else None
    if service is None or len(data) != LENGTH:
        return f"{'master' if by_master else 'slave'}: {data.hex(' ') or 'no data'}"
    return _request_text(service, data) if by_master else _answer_text(service, data)


def _node_id_text(number: int) -> str:
    return "none (unconfigured)" if number == UNCONFIGURED else str(number)


def _rate_text(table: int, index: int) -> str:
    if table != CIA_TABLE:
        return f"entry {index} of table {table}"
    return "automatic" if index == AUTOMATIC else f"{BIT_RATES[index]} kbit/s" if index in BIT_RATES else f"entry {index}"


def _plain(service: LssService) -> str:
    return service.name.lower().replace("_", " ").replace("node id", "node-ID")


def _request_text(service: LssService, data: bytes) -> str:
    match service:
        case LssService.SWITCH_GLOBAL:
            state = {0: "waiting", 1: "configuration"}.get(data[1], f"state {data[1]}")
            return f"all slaves: {state}"
        case LssService.CONFIGURE_NODE_ID:
            return f"node-ID becomes {_node_id_text(data[1])}"
        case LssService.CONFIGURE_BIT_TIMING:
            return f"bit rate becomes {_rate_text(data[1], data[2])}"
        case LssService.ACTIVATE_BIT_TIMING:
            return f"switch to the new bit rate after {int.from_bytes(data[1:3], 'little')} ms, and again so long silence"
        case LssService.STORE | LssService.IDENTIFY_NON_CONFIGURED:
            return {LssService.STORE: "store node-ID and bit rate"}.get(service, "who has no node-ID?")
        case LssService.FASTSCAN:
            number, bit_check, sub, following = fastscan_of(data)
            if bit_check == CONFIRM:
                return "fastscan begins: who has no node-ID?"
            name = field_name(sub)
            if bit_check == 0 and following != sub:
                return f"fastscan: is the {name} 0x{number:08X}?"
            return f"fastscan: is the {name} 0x{number:08X} down to bit {bit_check}?"
        case _ if LssService.INQUIRE_VENDOR <= service <= LssService.INQUIRE_NODE_ID:
            return f"{_plain(service)}?"
        case _:
            return f"{_plain(service)} 0x{number_of(data):08X}"


def _answer_text(service: LssService, data: bytes) -> str:
    match service:
        case LssService.SELECTED:
            return "slave: I am selected"
        case LssService.IDENTIFIED:
            return "slave: yes"
        case LssService.NON_CONFIGURED:
            return "slave: I have no node-ID"
        case LssService.INQUIRE_NODE_ID:
            return f"slave: node-ID {_node_id_text(data[1])}"
        case LssService.CONFIGURE_NODE_ID | LssService.CONFIGURE_BIT_TIMING | LssService.STORE:
            return f"slave: {_plain(service)}: {error_text(service, data[1], data[2]) or 'done'}"
        case _ if LssService.INQUIRE_VENDOR <= service <= LssService.INQUIRE_SERIAL:
            return f"slave: {_plain(service).removeprefix('inquire ')} 0x{number_of(data):08X}"
        case _:
            return f"slave: {data.hex(' ')}"
