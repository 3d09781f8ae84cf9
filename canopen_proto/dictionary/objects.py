"""What a dictionary is made of: an `Object` at each index, a `Variable` at each of its subindices.

Theory of operation
-------------------
A variable is what SDO and PDO transfer: its place, its name, its type, what may be done with it, what it holds at first. Most
fields are CiA 301's (v4.2.0, 7.4); what only an EDS or DCF knows of it (CiA 306-1) stands at the end, and no machine of the core
looks at it: a configuration tool does. Neither class changes once made.

A vendor's file has thousands of variables, most of which are never used: so they are cheap to make.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from types import MappingProxyType
from typing import TypeAlias

from canopen_proto.datatypes import Codec, DataType, Value, ValueRangeError, codec_of
from canopen_proto.multiplexer import Mux, mux


class Access(StrEnum):
    """What SDO may do with an object (CiA 301 v4.2.0, 7.4.8.3). RWR and RWW are RW that a TPDO, an RPDO may carry (CiA 306)."""

    RO = "ro"
    WO = "wo"
    RW = "rw"
    RWR = "rwr"
    RWW = "rww"
    CONST = "const"

    @property
    def readable(self) -> bool:
        return self is not Access.WO

    @property
    def writable(self) -> bool:
        return self is not Access.RO and self is not Access.CONST


class ObjectType(IntEnum):
    """Object codes (CiA 301 v4.2.0, 7.4.3, table 42)."""

    NULL = 0
    DOMAIN = 2
    DEFTYPE = 5
    DEFSTRUCT = 6
    VAR = 7
    ARRAY = 8
    RECORD = 9


@dataclass(slots=True, unsafe_hash=True)  # not frozen: that makes one cost three times as much
class Variable:
    """What stands at one index and subindex.

    default: what it holds after start-up; None = the type's zero, or the limit next to it. adds_node_id: the device's node-ID is
    added to the default ("$NODEID+0x80" of an EDS). low_limit, high_limit: what a write may not pass, None = the type's own
    limits. pdo_mappable: a PDO may carry it, in the direction that its access allows. mux and codec (how its values become bytes)
    follow from the rest.

    configured, configured_adds_node_id: what a DCF sets it to (ParameterValue), None = nothing; see `initial_of`. object_flags:
    bit 0, not to be written by a download of the whole dictionary; bit 1, not to be read by an upload of it (ObjFlags). unit,
    factor: the physical value is factor x value, in that unit. denotation: what this one device calls it (DCF). upload_file,
    download_file: where a tool keeps what a DOMAIN holds. not_read: why a backup has no value of it, "" = it has one, or the file
    is no backup.
    """

    index: int
    subindex: int
    name: str
    data_type: DataType
    access: Access = Access.RW
    default: Value | None = None
    low_limit: int | float | None = None
    high_limit: int | float | None = None
    pdo_mappable: bool = False
    aliases: tuple[str, ...] = ()
    adds_node_id: bool = False
    configured: Value | None = None
    configured_adds_node_id: bool = False
    object_flags: int = 0
    unit: str = ""
    factor: float = 1.0
    description: str = ""
    denotation: str = ""
    upload_file: str = ""
    download_file: str = ""
    not_read: str = ""
    mux: Mux = field(init=False, repr=False, compare=False)
    codec: Codec = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self.mux = mux(self.index, self.subindex)
        self.codec = codec_of(self.data_type)

    @property
    def size(self) -> int | None:
        """Bytes by SDO; None: any number."""
        return self.codec.size

    @property
    def bit_length(self) -> int | None:
        """Bits in a PDO; None: it has no width of its own there."""
        return self.codec.bit_length

    @property
    def label(self) -> str:
        """Name and place, for people; `str` gives the same."""
        return f"{self.name} (0x{self.index:04X}:{self.subindex:02X})"

    @property
    def names(self) -> tuple[str, ...]:
        """All its names."""
        return (self.name, *self.aliases)

    def initial_of(self, node_id: int) -> Value:
        """What it holds in the device of that node-ID at first: what a DCF has configured, else the default."""
        value = self.configured
        if value is None:
            return self.default_of(node_id)
        return value + node_id if self.configured_adds_node_id and isinstance(value, int) else value

    def default_of(self, node_id: int) -> Value:
        """What it holds in the device of that node-ID by default."""
        value = self._zero() if self.default is None else self.default
        return value + node_id if self.adds_node_id and isinstance(value, int) else value

    def _zero(self) -> Value:
        """The type's zero, or what is next to it within the limits, where there is a value within them."""
        zero = self.codec.zero
        low, high = self.low_limit, self.high_limit
        if not isinstance(zero, int | float) or (low is not None and high is not None and low > high):
            return zero
        if low is not None and zero < low:
            return low
        return high if high is not None and zero > high else zero

    def encode(self, value: Value) -> bytes:
        """The value's bytes as SDO carries them. Raises ValueRangeError that names this object. Limits: `check_limits`."""
        return self.codec.encode(value, self)

    def decode(self, data: bytes) -> Value:
        """The value of bytes as SDO carries them. Raises ValueRangeError (wrong length) that names this object."""
        return self.codec.decode(data, self)

    def check_limits(self, value: Value) -> None:
        """Raise ValueRangeError where a number lies outside low_limit..high_limit."""
        if isinstance(value, int | float):
            low, high = self.low_limit, self.high_limit
            if (low is not None and value < low) or (high is not None and value > high):
                limits = f"{'' if low is None else low}..{'' if high is None else high}"
                raise ValueRangeError(f"{self.label}: {value} is outside {limits} (limits of this object)")

    def __str__(self) -> str:
        return self.label


Key: TypeAlias = str | int | tuple[int, int] | Variable
"""What names a variable: "statusword", "record:field", "6041", "0x6041", "6041:00", "6041.0" (numbers in text are hexadecimal);
0x6041; (0x60C1, 1); the Variable itself; its multiplexer, as 0x60C101 (`Mux`)."""


@dataclass(slots=True, unsafe_hash=True)  # not frozen: that makes one cost three times as much
class Object:
    """What stands at one index: its variables by subindex.

    data_type: of the whole object, as an EDS has it: that of its entries (ARRAY), a DEFSTRUCT's index (RECORD), None = not said.
    object_flags, denotation: as of `Variable`.
    """

    index: int
    name: str
    object_type: ObjectType
    variables: Mapping[int, Variable]
    data_type: int | None = None
    object_flags: int = 0
    denotation: str = ""

    @classmethod
    def of(cls, name: str, variables: Iterable[Variable], object_type: ObjectType | None = None) -> Object:
        """An object of these variables, which share one index; a VAR where the only one stands at subindex 0, else a RECORD."""
        by_subindex = {variable.subindex: variable for variable in variables}
        if object_type is None:
            object_type = ObjectType.VAR if list(by_subindex) == [0] else ObjectType.RECORD
        (index,) = {variable.index for variable in by_subindex.values()}
        return cls(index, name, object_type, MappingProxyType(by_subindex))
