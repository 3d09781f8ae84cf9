"""The data types of CiA 301 and their Python values.

Every object of a dictionary has one of the static data types of CiA 301 v4.2.0, 7.1. (Table 44 has their codes, which are also
the indices of dummy entries in a PDO mapping.) On the wire all are little-endian. In Python they are

    BOOLEAN                            bool                  one byte by SDO, one bit in a PDO
    INTEGER8 .. 64, UNSIGNED8 .. 64    int                   with the 24-, 40-, 48- and 56-bit ones
    REAL32, REAL64                     float                 IEEE 754
    VISIBLE_STRING                     str                   see below
    UNICODE_STRING                     str                   16-bit units
    OCTET_STRING, DOMAIN               bytes
    TIME_OF_DAY                        datetime (UTC)        milliseconds and days since 1984-01-01
    TIME_DIFFERENCE                    timedelta             milliseconds and days

`decode` loses nothing: `encode` returns the same bytes for a decoded value (except the four unused bits of the two times, and the
quiet bit of a REAL32 that is NaN). So a server may keep values instead of bytes. For this reason a VISIBLE_STRING is Latin-1
text, although the standard allows only 0x00 and 0x20..0x7E: devices do send degree signs. NULs at its end stay;
`text.rstrip("\\0")` removes them for people.

Left out: the bit-wise types of PDO mapping parameters (INTEGERn with n below 8), which no object has, and the records of 7.1.6,
such as PDO parameters, which are objects with subindices.
"""

from __future__ import annotations

import datetime
import math
import re
import reprlib
import struct
from abc import ABC, abstractmethod
from enum import IntEnum
from typing import Final, TypeAlias

from canopen_proto.compiling import mypyc_attr
from canopen_proto.machine import LocalProtocolError

Value: TypeAlias = bool | int | float | str | bytes | datetime.datetime | datetime.timedelta
"""A value of an object, in Python."""

__all__ = ["DataType", "Value", "ValueRangeError", "decode", "encode", "range_of", "size_of"]

EPOCH: Final = datetime.datetime(1984, 1, 1, tzinfo=datetime.UTC)
"""Day 0 of TIME_OF_DAY (CiA 301 v4.2.0, 7.1.6.6)."""

_MS_PER_DAY: Final = 86_400_000
_TIME = struct.Struct("<IH")
_ROUNDED_TO_0: Final = 2.0**-150
"""Half of the least number of REAL32; IEEE 754 rounds it to the even one of its neighbours."""
_LETTERS: Final = {1: "b", 2: "h", 4: "i", 8: "q"}
"""By size in bytes: how `struct` calls a signed integer."""


class DataType(IntEnum):
    """The codes of the static data types, as in EDS files and in the dictionary (CiA 301 v4.2.0, 7.4.7, table 44)."""

    BOOLEAN = 0x01
    INTEGER8 = 0x02
    INTEGER16 = 0x03
    INTEGER32 = 0x04
    UNSIGNED8 = 0x05
    UNSIGNED16 = 0x06
    UNSIGNED32 = 0x07
    REAL32 = 0x08
    VISIBLE_STRING = 0x09
    OCTET_STRING = 0x0A
    UNICODE_STRING = 0x0B
    TIME_OF_DAY = 0x0C
    TIME_DIFFERENCE = 0x0D
    DOMAIN = 0x0F
    INTEGER24 = 0x10
    REAL64 = 0x11
    INTEGER40 = 0x12
    INTEGER48 = 0x13
    INTEGER56 = 0x14
    INTEGER64 = 0x15
    UNSIGNED24 = 0x16
    UNSIGNED40 = 0x18
    UNSIGNED48 = 0x19
    UNSIGNED56 = 0x1A
    UNSIGNED64 = 0x1B


@mypyc_attr(native_class=False)
class ValueRangeError(LocalProtocolError, ValueError):
    """A value does not fit its object: wrong kind, out of range, or wrong length. The text names object, type and range."""


def encode(value: Value, data_type: DataType, name: object = "value") -> bytes:
    """Return the bytes of a value, as SDO carries them.

    Integers take int and bool, reals float and int. REAL32 rounds to the nearest value that it can hold; times are cut to whole
    milliseconds. name: the object's name in errors, by its `str`. Raises ValueRangeError. Source: CiA 301 v4.2.0, 7.1.
    """
    return _CODECS[data_type].encode(value, name)


def decode(data: bytes, data_type: DataType, name: object = "value") -> Value:
    """Return the value of bytes, as SDO carries them. name: the object's name in errors, by its `str`.

    Raises ValueRangeError if the length is not the type's, or if a time has more milliseconds than a day. A machine that decodes
    a peer's bytes catches it. Source: CiA 301 v4.2.0, 7.1.
    """
    return _CODECS[data_type].decode(data, name)


def text_for_people(value: str, data_type: DataType) -> str:
    """Return a text for people. Some devices send VISIBLE_STRINGs in UTF-8: bytes that are valid UTF-8 are shown as UTF-8, others
    as Latin-1."""
    if data_type is DataType.VISIBLE_STRING:
        try:
            return value.encode("latin-1").decode("utf-8")
        except UnicodeError:  # Latin-1
            pass
    return value


def size_of(data_type: DataType) -> int | None:
    """Return the number of bytes by SDO; None if the length varies (strings, DOMAIN)."""
    return _CODECS[data_type].size


def bit_length_of(data_type: DataType) -> int | None:
    """Return the number of bits in a PDO (1 for BOOLEAN); None if the length varies."""
    return _CODECS[data_type].bit_length


def real_of(text: str) -> float:
    """Return the number in a text, as `float` does. Raises ValueError also for one of which `float` makes 0 or infinity in
    silence, as 1e-400 and 1e400."""
    number = float(text)
    if math.isinf(number) and "inf" not in text.lower():
        raise ValueError(f"{text[:40]} is too large: it would become infinity")
    if not number and re.search("[1-9]", re.split("[eE]", text)[0]):
        raise ValueError(f"{text[:40]} is too small: it would become 0")
    return number


def vanishes(number: float, data_type: DataType) -> bool:
    """Return whether a number that is not 0 becomes 0 in a type, as 1e-50 does in REAL32. This is for what a person or a file
    gives; `encode` rounds in silence, since the values of a control loop may be as small."""
    return data_type is DataType.REAL32 and 0.0 < abs(number) <= _ROUNDED_TO_0


def is_integer(data_type: DataType) -> bool:
    """Return whether a type is INTEGERn or UNSIGNEDn."""
    return isinstance(_CODECS[data_type], _Integer)


def is_signed(data_type: DataType) -> bool:
    """Return whether a type is INTEGERn."""
    codec = _CODECS[data_type]
    return isinstance(codec, _Integer) and codec.signed


def is_number(data_type: DataType) -> bool:
    """Return whether a type is INTEGERn, UNSIGNEDn or REALn."""
    return isinstance(_CODECS[data_type], _Integer | _Real)


def range_of(data_type: DataType) -> tuple[int, int] | None:
    """Return the least and the greatest value of an integer type (0 and 1 for BOOLEAN); None for all others."""
    if data_type == DataType.BOOLEAN:
        return 0, 1
    codec = _CODECS[data_type]
    return (codec.low, codec.high) if isinstance(codec, _Integer) else None


def zero_of(data_type: DataType) -> Value:
    """Return the value of an object without a default: 0, False, "", b"", the epoch."""
    return _CODECS[data_type].zero


def integer_type(size: int, *, signed: bool = False) -> DataType:
    """Return the integer type of `size` bytes, 1..8. Raises KeyError for other sizes."""
    return _INTEGER_TYPES[size, signed]


def codec_of(data_type: DataType) -> Codec:
    """Return the codec of a data type, for code that encodes or decodes one object often."""
    return _CODECS[data_type]


class Codec(ABC):
    """Encodes and decodes one data type. size, bit_length, zero: as `size_of`, `bit_length_of`, `zero_of`."""

    __slots__ = ("bit_length", "data_type", "size", "zero")

    def __init__(self, data_type: DataType, size: int | None, zero: Value) -> None:
        self.data_type = data_type
        self.size = size
        self.bit_length = None if size is None else size * 8
        self.zero = zero

    @abstractmethod
    def encode(self, value: Value, name: object) -> bytes: ...

    @abstractmethod
    def decode(self, data: bytes, name: object) -> Value: ...

    def wrong_kind(self, value: object, name: object, expected: str) -> ValueRangeError:
        return ValueRangeError(f"{name}: {self.data_type.name} takes {expected}, not {_show(value)}")

    def wrong_length(self, data: bytes, name: object, expected: object) -> ValueRangeError:
        return ValueRangeError(f"{name}: {self.data_type.name} has {expected} bytes, not {len(data)}")


class _Boolean(Codec):
    """One byte by SDO, one bit in a PDO. Any byte except 0 is read as true: devices send 0xFF as well as 1."""

    __slots__ = ()

    def __init__(self) -> None:
        super().__init__(DataType.BOOLEAN, 1, False)
        self.bit_length = 1

    def encode(self, value: Value, name: object) -> bytes:
        if value is True or value is False or (isinstance(value, int) and value in (0, 1)):
            return b"\x01" if value else b"\x00"
        raise self.wrong_kind(value, name, "True or False")

    def decode(self, data: bytes, name: object) -> bool:
        if len(data) != 1:
            raise self.wrong_length(data, name, 1)
        return data[0] != 0


class _Integer(Codec):
    """An integer, little-endian; a signed one in two's complement."""

    __slots__ = ("high", "low", "signed", "width")

    def __init__(self, data_type: DataType, size: int, signed: bool) -> None:
        super().__init__(data_type, size, 0)
        self.width = size
        self.signed = signed
        self.low = -(1 << 8 * size - 1) if signed else 0
        self.high = (1 << 8 * size - signed) - 1

    def encode(self, value: Value, name: object) -> bytes:
        if not isinstance(value, int):
            raise self.wrong_kind(value, name, "an integer")
        try:
            return value.to_bytes(self.width, "little", signed=self.signed)
        except OverflowError:
            raise self.out_of_range(value, name) from None

    def decode(self, data: bytes, name: object) -> int:
        if len(data) != self.width:
            raise self.wrong_length(data, name, self.width)
        return int.from_bytes(data, "little", signed=self.signed)

    def out_of_range(self, value: object, name: object) -> ValueRangeError:
        return ValueRangeError(f"{name}: {_show(value)} is outside {self.low}..{self.high} ({self.data_type.name})")


class _MachineInteger(_Integer):
    """An integer of 1, 2, 4 or 8 bytes, as nearly all are: `struct` takes half the time for these."""

    __slots__ = ("layout",)

    def __init__(self, data_type: DataType, size: int, signed: bool) -> None:
        super().__init__(data_type, size, signed)
        letter = _LETTERS[size]
        self.layout = struct.Struct("<" + (letter if signed else letter.upper()))

    def encode(self, value: Value, name: object) -> bytes:
        if not isinstance(value, int):
            raise self.wrong_kind(value, name, "an integer")
        try:
            return self.layout.pack(value)
        except struct.error:
            raise self.out_of_range(value, name) from None

    def decode(self, data: bytes, name: object) -> int:
        if len(data) != self.width:
            raise self.wrong_length(data, name, self.width)
        value: int = self.layout.unpack(data)[0]
        return value


class _Real(Codec):
    """An IEEE 754 number. Infinities and NaN are values like others."""

    __slots__ = ("layout",)

    def __init__(self, data_type: DataType, layout: str) -> None:
        self.layout = struct.Struct(layout)
        super().__init__(data_type, self.layout.size, 0.0)

    def encode(self, value: Value, name: object) -> bytes:
        if not isinstance(value, float | int):
            raise self.wrong_kind(value, name, "a number")
        try:
            return self.layout.pack(float(value))
        except OverflowError:
            raise ValueRangeError(f"{name}: {_show(value)} is too large for {self.data_type.name}") from None

    def decode(self, data: bytes, name: object) -> float:
        if len(data) != self.size:
            raise self.wrong_length(data, name, self.size)
        value: float = self.layout.unpack(data)[0]
        return value


class _VisibleString(Codec):
    __slots__ = ()

    def encode(self, value: Value, name: object) -> bytes:
        if not isinstance(value, str):
            raise self.wrong_kind(value, name, "text")
        try:
            return value.encode("latin-1")
        except UnicodeEncodeError as error:
            foreign = value[error.start]
            raise ValueRangeError(f"{name}: a VISIBLE_STRING has no character {foreign!a} ({_show(value)})") from None

    def decode(self, data: bytes, name: object) -> str:
        return bytes(data).decode("latin-1")


class _UnicodeString(Codec):
    """An array of UNSIGNED16, read as UTF-16. Half of a surrogate pair is accepted, so that no bytes are lost."""

    __slots__ = ()

    def encode(self, value: Value, name: object) -> bytes:
        if not isinstance(value, str):
            raise self.wrong_kind(value, name, "text")
        return value.encode("utf-16-le", "surrogatepass")

    def decode(self, data: bytes, name: object) -> str:
        if len(data) % 2:
            raise self.wrong_length(data, name, "an even number of")
        return bytes(data).decode("utf-16-le", "surrogatepass")


class _Octets(Codec):
    __slots__ = ()

    def encode(self, value: Value, name: object) -> bytes:
        if not isinstance(value, bytes | bytearray | memoryview):
            raise self.wrong_kind(value, name, "bytes")
        return bytes(value)

    def decode(self, data: bytes, name: object) -> bytes:
        return bytes(data)


class _Difference(Codec):
    """28 bits of milliseconds, 4 unused bits, 16 bits of days (CiA 301 v4.2.0, 7.1.6.7)."""

    __slots__ = ()

    def encode(self, value: Value, name: object) -> bytes:
        if not isinstance(value, datetime.timedelta):
            raise self.wrong_kind(value, name, "a timedelta")
        days, milliseconds = divmod(value // datetime.timedelta(milliseconds=1), _MS_PER_DAY)
        if not 0 <= days <= 0xFFFF:
            raise ValueRangeError(f"{name}: {value} is outside 0..65535 days ({self.data_type.name})")
        return _TIME.pack(milliseconds, days)

    def decode(self, data: bytes, name: object) -> Value:
        return self.span(data, name)

    def span(self, data: bytes, name: object) -> datetime.timedelta:
        if len(data) != _TIME.size:
            raise self.wrong_length(data, name, _TIME.size)
        milliseconds, days = _TIME.unpack(data)
        milliseconds &= 0x0FFF_FFFF
        if milliseconds >= _MS_PER_DAY:
            raise ValueRangeError(f"{name}: {milliseconds} ms is more than a day ({self.data_type.name})")
        return datetime.timedelta(days=days, milliseconds=milliseconds)


class _TimeOfDay(_Difference):
    """The bits of a TIME_DIFFERENCE, counted from the epoch. The standard names no time zone; this is UTC."""

    __slots__ = ()

    def encode(self, value: Value, name: object) -> bytes:
        if not isinstance(value, datetime.datetime) or value.tzinfo is None:
            raise self.wrong_kind(value, name, "a datetime with its time zone")
        try:
            return super().encode(value - EPOCH, name)
        except ValueRangeError:
            last = (EPOCH + datetime.timedelta(days=0xFFFF)).date()
            raise ValueRangeError(f"{name}: {value} is outside {EPOCH.date()}..{last} (TIME_OF_DAY)") from None

    def decode(self, data: bytes, name: object) -> Value:
        return EPOCH + self.span(data, name)


def _show(value: object) -> str:
    """Return a value for an error text, cut to one line. (CPython refuses to print integers of thousands of digits.)"""
    if isinstance(value, int) and value.bit_length() > 128:
        return f"an integer of {value.bit_length()} bits"
    return reprlib.repr(value)


_INTEGER_TYPES: Final[dict[tuple[int, bool], DataType]] = {
    (size, signed): DataType[f"{'INTEGER' if signed else 'UNSIGNED'}{8 * size}"]
    for size in range(1, 9)
    for signed in (False, True)
}

_CODECS: Final[dict[DataType, Codec]] = {
    DataType.BOOLEAN: _Boolean(),
    **{
        data_type: (_MachineInteger if size in _LETTERS else _Integer)(data_type, size, signed)
        for (size, signed), data_type in _INTEGER_TYPES.items()
    },
    DataType.REAL32: _Real(DataType.REAL32, "<f"),
    DataType.REAL64: _Real(DataType.REAL64, "<d"),
    DataType.VISIBLE_STRING: _VisibleString(DataType.VISIBLE_STRING, None, ""),
    DataType.OCTET_STRING: _Octets(DataType.OCTET_STRING, None, b""),
    DataType.UNICODE_STRING: _UnicodeString(DataType.UNICODE_STRING, None, ""),
    DataType.TIME_OF_DAY: _TimeOfDay(DataType.TIME_OF_DAY, 6, EPOCH),
    DataType.TIME_DIFFERENCE: _Difference(DataType.TIME_DIFFERENCE, 6, datetime.timedelta(0)),
    DataType.DOMAIN: _Octets(DataType.DOMAIN, None, b""),
}
