"""The parts of a dictionary: an `Object` at each index, a `Variable` at each of its subindices.

A variable is what SDO and PDO transfer. It has a place, a name, a type, access rights and an initial value. The first fields are
those of CiA 301 (v4.2.0, 7.4). The last ones come from an EDS or DCF (CiA 306-1); only configuration tools use them. Neither
class changes once made.

A vendor's file has thousands of variables, most of which are never used: so they are cheap to make.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from types import MappingProxyType
from typing import Final, TypeAlias

from canopen_proto import indices
from canopen_proto.cob_id import cob_id_without_value
from canopen_proto.datatypes import Codec, DataType, Value, ValueRangeError, codec_of
from canopen_proto.machine import LocalProtocolError
from canopen_proto.multiplexer import Mux, mux

_HOLDS_COB_ID: Final = (DataType.UNSIGNED32, DataType.UNSIGNED64)


class Access(StrEnum):
    """The access to an object by SDO (CiA 301 v4.2.0, 7.4.8.3). RWR: RW, and a TPDO may carry it; RWW: an RPDO may (CiA 306)."""

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
        return self not in _NEVER_WRITTEN


_NEVER_WRITTEN: Final = (Access.RO, Access.CONST)  # a member that is looked up in its class takes longer than all of this


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
    """The object at one index and subindex.

    default: its value after start-up; None = the type's zero, or the limit nearest to it. adds_node_id: the device's node-ID is
    added to the default ("$NODEID+0x80" of an EDS). low_limit, high_limit: the range of a write; None = the type's own limit.
    pdo_mappable: a PDO may carry it, in the direction that its access allows. mux, codec: set from the other fields.

    configured, configured_adds_node_id: the value that a DCF sets (ParameterValue); None = none. See `initial_of`. object_flags
    (ObjFlags): bit 0 forbids a download of the whole dictionary to write it, bit 1 forbids an upload to read it. unit, factor:
    the physical value is factor x value, in that unit. denotation: the name that this one device gives it (DCF). upload_file,
    download_file: where a tool keeps the content of a DOMAIN. not_read: why a backup has no value of it; "" in any other file.
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
        try:
            self.codec = codec_of(self.data_type)
        except KeyError:
            raise LocalProtocolError(f"{self.label}: there is no data type {self.data_type!r}") from None

    @property
    def size(self) -> int | None:
        """The number of bytes by SDO; None = any number."""
        return self.codec.size

    @property
    def bit_length(self) -> int | None:
        """The number of bits in a PDO; None = the mapping sets it."""
        return self.codec.bit_length

    @property
    def label(self) -> str:
        """Name and place for people, as `str` gives them."""
        return f"{self.name} (0x{self.index:04X}:{self.subindex:02X})"

    @property
    def names(self) -> tuple[str, ...]:
        """The name and the aliases."""
        return (self.name, *self.aliases)

    def initial_of(self, node_id: int) -> Value:
        """Return the value after start-up in the device with this node-ID: the configured one, else the default."""
        value = self.configured
        if value is None:
            return self.default_of(node_id)
        return value + node_id if self.configured_adds_node_id and isinstance(value, int) else value

    def default_of(self, node_id: int) -> Value:
        """Return the default in the device with this node-ID.

        Without one: for a COB-ID, that of the standard, since 0 would be NMT's; else the type's zero, or the limit nearest to it.
        """
        value = self.default
        if value is None:
            return self._without_value(node_id)
        return value + node_id if self.adds_node_id and isinstance(value, int) else value

    @property
    def depends_on_node_id(self) -> bool:
        """Whether another node-ID gives another default, or another configured value."""
        if self.adds_node_id or self.configured_adds_node_id:
            return True
        is_set = self.default is not None or self.index not in indices.COMMUNICATION_AREA
        return not is_set and self._without_value(1) != self._without_value(2)

    def _without_value(self, node_id: int) -> Value:
        if self.index in indices.COMMUNICATION_AREA and self.data_type in _HOLDS_COB_ID:
            cob_id = cob_id_without_value(self.index, self.subindex, node_id)
            if cob_id is not None:
                return cob_id
        zero = self.codec.zero
        low, high = self.low_limit, self.high_limit
        if not isinstance(zero, int | float) or (low is not None and high is not None and low > high):
            return zero
        if low is not None and zero < low:
            return low
        return high if high is not None and zero > high else zero

    def encode(self, value: Value) -> bytes:
        """Return the value's bytes as SDO carries them. Raises ValueRangeError if the type cannot hold it; see `check_limits`."""
        return self.codec.encode(value, self)

    def decode(self, data: bytes) -> Value:
        """Return the value of bytes as SDO carries them. Raises ValueRangeError if their number is not the type's. data:
        little-endian."""
        return self.codec.decode(data, self)

    def check_limits(self, value: Value) -> None:
        """Raise ValueRangeError if a number is outside low_limit..high_limit. Values that are no numbers have no limits."""
        if isinstance(value, int | float):
            low, high = self.low_limit, self.high_limit
            if (low is not None and value < low) or (high is not None and value > high):
                limits = f"{'' if low is None else low}..{'' if high is None else high}"
                raise ValueRangeError(f"{self.label}: {value} is outside {limits} (limits of this object)")

    def may_be(self, value: int) -> bool:
        """Return whether a number is within low_limit..high_limit. Limits that exclude each other are no limits."""
        low, high = self.low_limit, self.high_limit
        if low is not None and high is not None and low > high:
            return True
        return (low is None or low <= value) and (high is None or value <= high)

    def __str__(self) -> str:
        return self.label


Key: TypeAlias = str | int | tuple[int, int] | Variable
"""A way to name a variable: "statusword", "record:field", "6041", "0x6041", "6041:00", "6041.0" (numbers in text are
hexadecimal); 0x6041; (0x60C1, 1); the Variable itself; its multiplexer, such as 0x60C101 (`Mux`)."""


@dataclass(slots=True, unsafe_hash=True)  # not frozen: that makes one cost three times as much
class Object:
    """The object at one index, with its variables by subindex.

    data_type: of the whole object, as an EDS gives it: the type of the entries (ARRAY) or the index of a DEFSTRUCT (RECORD); None
    = not given. object_flags, denotation: as in `Variable`.
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
        """Make an object of these variables, which share one index. object_type: None = VAR for a single one at subindex 0, else
        RECORD. name: of the object."""
        by_subindex = {variable.subindex: variable for variable in variables}
        if object_type is None:
            object_type = ObjectType.VAR if list(by_subindex) == [0] else ObjectType.RECORD
        (index,) = {variable.index for variable in by_subindex.values()}
        return cls(index, name, object_type, MappingProxyType(by_subindex))
