"""What a client asks a gateway for (CiA 309-3): `GatewayRequest`, and the table of all commands.

A request is a line: `[seq] [[net] node] command arguments`. Before a command about a node one number is the node, two are net and
node; before one about a net one number is the net; before one about the gateway there is none. The table says what each command
is about, and which numbers follow it. request_text.py reads and writes the lines.

Commands of CANopenNode, of Lely CANopen, and of both. Those with an underscore before them are not the standard's: `_lss_...`
are CANopenNode's and Lely's, `_halt` is ours.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from canopen_proto.gateway.value_types import ValueType

MAX_SEQUENCE: Final = 0xFFFF_FFFF
MAX_NET: Final = 0xFFFF
MAX_PDO_VALUES: Final = 64
"""The objects that one PDO can have: 64 single bits."""
MAX_PDO_NUMBER: Final = 512

EVENT: Final = 255
"""The transmission type that is typed as `event`."""
RTR: Final = 253
"""The transmission type that is typed as `rtr`."""
MAX_SYNC: Final = 240
"""The highest transmission type that is typed as `sync0` to `sync240`."""


class About(Enum):
    """What a command is about, and so which numbers stand before it."""

    GATEWAY = 0
    NET = 1
    NODE = 2


class Tail(Enum):
    """What follows the numbers of a command."""

    NOTHING = "nothing"
    TYPE = "a type, which may be left out"
    VALUE = "a type and a value"
    COUNTED = "a count, and so many numbers"
    MAPPING = "a transmission type, a count, and so many objects"
    EXTENDED_MAPPING = "the same, with inhibit time, event timer or SYNC start value behind the transmission type"


@dataclass(frozen=True)
class Syntax:
    """How a command is typed. words: the spellings of each of its words, the first of which is written. numbers: the bounds of
    the numbers that follow. counts: how many of them may be given; empty: all."""

    words: tuple[tuple[str, ...], ...]
    about: About
    numbers: tuple[tuple[int, int], ...] = ()
    counts: tuple[int, ...] = ()
    tail: Tail = Tail.NOTHING


_U8: Final = (0, 0xFF)
_U16: Final = (0, 0xFFFF)
_U32: Final = (0, 0xFFFF_FFFF)
_BIT: Final = (0, 1)
_NODE_ID: Final = (1, 127)
_PDO: Final = (1, MAX_PDO_NUMBER)
_SCAN: Final = (0, 2)


class GatewayCommand(Enum):
    """The commands, each with its `Syntax`."""

    READ = Syntax((("r", "read"),), About.NODE, (_U16, _U8), tail=Tail.TYPE)
    WRITE = Syntax((("w", "write"),), About.NODE, (_U16, _U8), tail=Tail.VALUE)
    START = Syntax((("start",),), About.NODE)
    STOP = Syntax((("stop",),), About.NODE)
    PRE_OPERATIONAL = Syntax((("preop", "preoperational"),), About.NODE)
    RESET_NODE = Syntax((("reset",), ("node",)), About.NODE)
    RESET_COMMUNICATION = Syntax((("reset",), ("comm", "communication")), About.NODE)
    SET_NETWORK = Syntax((("set",), ("network",)), About.GATEWAY, ((0, MAX_NET),))
    SET_NODE = Syntax((("set",), ("node",)), About.NET, ((0, 127),))
    SET_SDO_TIMEOUT = Syntax((("set",), ("sdo_timeout",)), About.NET, ((1, 0xFFFF),))
    SET_SDO_BLOCK = Syntax((("set",), ("sdo_block",)), About.NET, (_BIT,))
    SET_ID = Syntax((("set",), ("id",)), About.NET, (_U8,))
    SET_HEARTBEAT = Syntax((("set",), ("heartbeat",)), About.NET, (_U16,))
    SET_COMMAND_TIMEOUT = Syntax((("set",), ("command_timeout",)), About.GATEWAY, (_U32,))
    SET_COMMAND_SIZE = Syntax((("set",), ("command_size",)), About.GATEWAY, (_U32,))
    SET_RPDO = Syntax((("set",), ("rpdo",)), About.NET, (_PDO, _U32), tail=Tail.MAPPING)
    SET_TPDO = Syntax((("set",), ("tpdo",)), About.NET, (_PDO, _U32), tail=Tail.MAPPING)
    SET_TPDOX = Syntax((("set",), ("tpdox",)), About.NET, (_PDO, _U32), tail=Tail.EXTENDED_MAPPING)
    READ_PDO = Syntax((("r", "read"), ("p", "pdo")), About.NET, (_PDO,))
    WRITE_PDO = Syntax((("w", "write"), ("p", "pdo")), About.NET, (_PDO,), tail=Tail.COUNTED)
    ENABLE_GUARDING = Syntax((("enable",), ("guarding",)), About.NODE, (_U16, _U8))
    DISABLE_GUARDING = Syntax((("disable",), ("guarding",)), About.NODE)
    ENABLE_HEARTBEAT = Syntax((("enable",), ("heartbeat",)), About.NODE, (_U16,))
    DISABLE_HEARTBEAT = Syntax((("disable",), ("heartbeat",)), About.NODE)
    ENABLE_BOOT_UP = Syntax((("boot_up_indication",), ("enable",)), About.NET)
    DISABLE_BOOT_UP = Syntax((("boot_up_indication",), ("disable",)), About.NET)
    INIT = Syntax((("init",),), About.NET, ((0, 9),))
    INFO_VERSION = Syntax((("info",), ("version",)), About.GATEWAY)
    HELP = Syntax((("help",),), About.GATEWAY)
    HELP_DATATYPE = Syntax((("help",), ("datatype",)), About.GATEWAY)
    HELP_LSS = Syntax((("help",), ("lss",)), About.GATEWAY)
    LED = Syntax((("led",),), About.GATEWAY)
    LOG = Syntax((("log",),), About.GATEWAY)
    LSS_SWITCH_GLOBAL = Syntax((("lss_switch_glob",),), About.NET, (_BIT,))
    LSS_SWITCH_SELECTIVE = Syntax((("lss_switch_sel",),), About.NET, (_U32,) * 4)
    LSS_SET_NODE = Syntax((("lss_set_node",),), About.NET, (_U8,))
    LSS_CONFIGURE_BIT_RATE = Syntax((("lss_conf_bitrate",),), About.NET, (_U8, _U8))
    LSS_ACTIVATE_BIT_RATE = Syntax((("lss_activate_bitrate",),), About.NET, (_U16,))
    LSS_STORE = Syntax((("lss_store",),), About.NET)
    LSS_INQUIRE_ADDRESS = Syntax((("lss_inquire_addr",),), About.NET, ((0, 0x5D),), (0, 1))
    LSS_GET_NODE = Syntax((("lss_get_node",),), About.NET)
    LSS_IDENTITY = Syntax((("lss_identity",),), About.NET, (_U32,) * 6)
    LSS_IDENTIFY_NON_CONFIGURED = Syntax((("lss_ident_nonconf",),), About.NET)
    LSS_SLOWSCAN = Syntax((("_lss_slowscan",),), About.NET, (_U32,) * 6)
    LSS_FASTSCAN = Syntax((("_lss_fastscan",),), About.NET, (_U32,) * 8, (0, 1, 8))
    LSS_ALL_NODES = Syntax((("lss_allnodes",),), About.NET, (_U16, _NODE_ID, _BIT, *(_SCAN, _U32) * 4), (0, 1, 3, 11))
    HALT = Syntax((("_halt",),), About.NODE)

    @property
    def syntax(self) -> Syntax:
        """How it is typed."""
        syntax: Syntax = self.value
        return syntax

    @property
    def about(self) -> About:
        """What it is about."""
        return self.syntax.about


@dataclass(frozen=True)
class MappedValue:
    """An object in a PDO of a gateway. index 0: a dummy entry of this type."""

    value_type: ValueType
    index: int = 0
    subindex: int = 0


@dataclass(frozen=True)
class GatewayRequest:
    """A request as it was understood.

    sequence: its number, 0..0xFFFFFFFF, which the answer repeats. net, node: those that were typed; None: the default. numbers:
    those of its `Syntax`; of `w pdo` also the values; of `set rpdo` and `set tpdo` also the transmission type; of `set tpdox`
    further the inhibit time, the event timer and the SYNC start value. value_type: of a read or a write; None: none was named.
    data: what is written, as SDO carries it. mapping: the objects of a PDO.
    """

    command: GatewayCommand
    sequence: int = 0
    net: int | None = None
    node: int | None = None
    numbers: tuple[int, ...] = ()
    value_type: ValueType | None = None
    data: bytes = b""
    mapping: tuple[MappedValue, ...] = field(default=())
