"""The data types of the text protocol of CiA 309-3, and their values as text.

    b                                  0, 1
    i8 .. i64, u8 .. u64               numbers, with the 24-, 40-, 48- and 56-bit ones; decimal, or hexadecimal with 0x
    x8 x16 x32 x64                     as u8 .. u64, but always shown in hexadecimal (CANopenNode's own)
    r32, r64                           1.5, -2e10, inf, nan
    t, td                              days and milliseconds, two numbers (TIME_OF_DAY: since 1984-01-01)
    vs                                 "text"; a quote inside is doubled. One word needs no quotes
    os, us, d                          base64, in one line
    hex                                bytes: 01 0A FF (CANopenNode's own, and its default where a read names no type)

A value is bytes here, as SDO carries them: what a text means as bytes, and back. A text of a device goes through as it is
(Latin-1), except for what would break a line. Source: CANopenNode 309/CO_gateway_ascii.c and Lely src/co/gw_txt.c, read.
"""

from __future__ import annotations

import binascii
import re
import struct
from dataclasses import dataclass
from enum import Enum
from typing import Final

from canopen_proto.datatypes import DataType, Value, ValueRangeError, decode, encode, is_signed, real_of, size_of, vanishes
from canopen_proto.gateway.dialect import CANOPENNODE, Dialect
from canopen_proto.machine import LocalProtocolError


class TextForm(Enum):
    """How values of a type are written."""

    NUMBER = "number"
    HEXADECIMAL = "number in hexadecimal"
    REAL = "real number"
    TIME = "days and milliseconds"
    QUOTED = "text in quotes"
    BASE64 = "base64"
    BYTES = "bytes in hexadecimal"


@dataclass(frozen=True)
class ValueType:
    """A data type of the text protocol. word: how it is typed. form: how its values are written."""

    word: str
    data_type: DataType
    form: TextForm

    @property
    def size(self) -> int | None:
        """Bytes of a value; None if the length varies."""
        return size_of(self.data_type)


def _types() -> dict[str, ValueType]:
    types = [ValueType("b", DataType.BOOLEAN, TextForm.NUMBER)]
    for bits in range(8, 65, 8):
        types += [
            ValueType(f"i{bits}", DataType[f"INTEGER{bits}"], TextForm.NUMBER),
            ValueType(f"u{bits}", DataType[f"UNSIGNED{bits}"], TextForm.NUMBER),
        ]
    types += [ValueType(f"x{bits}", DataType[f"UNSIGNED{bits}"], TextForm.HEXADECIMAL) for bits in (8, 16, 32, 64)]
    types += [
        ValueType("r32", DataType.REAL32, TextForm.REAL),
        ValueType("r64", DataType.REAL64, TextForm.REAL),
        ValueType("t", DataType.TIME_OF_DAY, TextForm.TIME),
        ValueType("td", DataType.TIME_DIFFERENCE, TextForm.TIME),
        ValueType("vs", DataType.VISIBLE_STRING, TextForm.QUOTED),
        ValueType("os", DataType.OCTET_STRING, TextForm.BASE64),
        ValueType("us", DataType.UNICODE_STRING, TextForm.BASE64),
        ValueType("d", DataType.DOMAIN, TextForm.BASE64),
        ValueType("hex", DataType.DOMAIN, TextForm.BYTES),
    ]
    return {each.word: each for each in types}


VALUE_TYPES: Final[dict[str, ValueType]] = _types()
"""The types by their words."""
HEX: Final = VALUE_TYPES["hex"]

_INTEGER: Final = re.compile(r"([+-]?)(?:0[xX]([0-9A-Fa-f]{1,20})|(0|[1-9][0-9]{0,24}))")
"""Decimal or hexadecimal. A leading 0 is refused: C reads it as octal, and people do not."""
_REAL: Final = re.compile(
    r"[+-]?(?:(?:[0-9]{1,40}(?:\.[0-9]{0,40})?|\.[0-9]{1,40})(?:[eE][+-]?[0-9]{1,5})?|inf|nan)", re.IGNORECASE
)
_TIME: Final = struct.Struct("<IH")
_MS_PER_DAY: Final = 86_400_000
_BREAKS_A_LINE: Final = dict.fromkeys(map(ord, "\0\r\n"))
_ESCAPES: Final = {
    "n": "\n",
    "r": "\r",
    "t": "\t",
    "a": "\a",
    "b": "\b",
    "f": "\f",
    "v": "\v",
    "\\": "\\",
    '"': '"',
    "'": "'",
    "?": "?",
}
_ESCAPE_OF: Final = {"\\": "\\\\", **{char: f"\\{letter}" for letter, char in _ESCAPES.items() if letter in "nrtabfv"}}


def integer_of(text: str) -> int | None:
    """Return the number in a text; None if it is none: decimal, or hexadecimal with 0x, at most 64 bits and some."""
    match = _INTEGER.fullmatch(text)
    if match is None:
        return None
    number = int(match[2], 16) if match[2] else int(match[3])
    return -number if match[1] == "-" else number


def parse_value(value_type: ValueType, text: str, dialect: Dialect = CANOPENNODE) -> bytes | None:
    """Return the bytes of a value that was typed; None if it is no value of its type, or beyond its range. text: as it stands in
    the line, with quotes and blanks. dialect: whether a backslash is an escape."""
    match value_type.form:
        case TextForm.NUMBER | TextForm.HEXADECIMAL:
            number = integer_of(text)
            return None if number is None else _encoded(number, value_type)
        case TextForm.REAL:
            return _real_of(text, value_type) if _REAL.fullmatch(text) else None
        case TextForm.TIME:
            return _time_of(text)
        case TextForm.QUOTED:
            return _unquoted(text, dialect)
        case TextForm.BASE64:
            return _from_base64(text, even=value_type.data_type is DataType.UNICODE_STRING)
        case TextForm.BYTES:
            return _from_hex(text)


def print_value(value_type: ValueType, data: bytes, dialect: Dialect = CANOPENNODE) -> str:
    """Return the bytes of a device as text, in one line. Bytes that do not have the length of the type are shown as `hex`."""
    size = value_type.size
    if size is not None and len(data) != size:
        return print_value(HEX, data)
    match value_type.form:
        case TextForm.NUMBER:
            number = int.from_bytes(data, "little", signed=is_signed(value_type.data_type))
            if value_type.data_type is DataType.BOOLEAN:
                return str(number) if dialect.hex_fallback else str(int(number != 0))
            is_unsigned = not is_signed(value_type.data_type)
            return f"0x{number:0{2 * len(data)}x}" if dialect.unsigned_hex and is_unsigned else str(number)
        case TextForm.HEXADECIMAL:
            return f"0x{int.from_bytes(data, 'little'):0{2 * len(data)}X}"
        case TextForm.REAL:
            return _real_text(data)
        case TextForm.TIME:
            milliseconds, days = _TIME.unpack(data)
            return f"{days} {milliseconds & 0x0FFF_FFFF}"
        case TextForm.QUOTED:
            return _quoted(data, dialect)
        case TextForm.BASE64:
            return binascii.b2a_base64(data, newline=False).decode("ascii")
        case TextForm.BYTES:
            return data.hex(" ").upper()


def fits(value_type: ValueType, data: bytes) -> bool:
    """Return whether bytes have the length of a type."""
    return value_type.size in (None, len(data))


def typed_value(value_type: ValueType, data: bytes, dialect: Dialect = CANOPENNODE) -> str:
    """Return bytes as they are typed in a request: `parse_value` makes the same bytes of it. Raises LocalProtocolError if the
    type cannot carry them: another length, a text with a line break where the dialect has no escapes, NaN with a payload."""
    text = print_value(value_type, data, dialect)
    if not fits(value_type, data) or parse_value(value_type, text, dialect) != data:
        raise LocalProtocolError(
            f"{len(data)} bytes {data[:16].hex(' ')} cannot be typed as {value_type.word}; hex can carry them"
        )
    return text


def _real_of(text: str, value_type: ValueType) -> bytes | None:
    try:
        number = real_of(text)
        return None if vanishes(number, value_type.data_type) else encode(number, value_type.data_type)
    except ValueError:  # ValueRangeError is one
        return None


def _encoded(value: Value, value_type: ValueType) -> bytes | None:
    try:
        return encode(value, value_type.data_type)
    except ValueRangeError:
        return None


def _real_text(data: bytes) -> str:
    """Return a real number with as many digits as it needs: six, as C's %g, unless they mean another number."""
    layout = "<f" if len(data) == 4 else "<d"
    (number,) = struct.unpack(layout, data)
    for digits in range(6, 17):
        text = f"{number:.{digits}g}"
        if struct.pack(layout, float(text)) == data:
            return text
    return f"{number:.17g}"


def _time_of(text: str) -> bytes | None:
    numbers = [integer_of(word) for word in text.split()]
    if len(numbers) != 2 or numbers[0] is None or numbers[1] is None:
        return None
    days, milliseconds = numbers[0], numbers[1]
    if not (0 <= days <= 0xFFFF and 0 <= milliseconds < _MS_PER_DAY):
        return None
    return _TIME.pack(milliseconds, days)


def _quoted(data: bytes, dialect: Dialect) -> str:
    text = str(decode(data, DataType.VISIBLE_STRING))
    if dialect.escapes:
        shown = "".join(_ESCAPE_OF.get(char) or (char if char.isprintable() else f"\\{ord(char):03o}") for char in text)
    else:
        shown = text.translate(_BREAKS_A_LINE)
    return '"{}"'.format(shown.replace('"', '""'))


def _unquoted(text: str, dialect: Dialect) -> bytes | None:
    if text.startswith('"'):
        if len(text) < 2 or not text.endswith('"'):
            return None
        text = text[1:-1]
        if '"' in text.replace('""', ""):
            return None
        text = text.replace('""', '"')
    elif not text or '"' in text or " " in text or "\t" in text:
        return None
    if dialect.escapes:
        return _without_escapes(text)
    return encode(text, DataType.VISIBLE_STRING) if max(text, default="") <= "\xff" else None


_ESCAPED: Final = re.compile(r"\\(?:x([0-9A-Fa-f]{1,2})|([0-7]{1,3})|(.))|\\\Z", re.DOTALL)


def _without_escapes(text: str) -> bytes | None:
    parts, end = [], 0
    for match in _ESCAPED.finditer(text):
        parts.append(text[end : match.start()])
        end = match.end()
        if match[1]:
            parts.append(chr(int(match[1], 16)))
        elif match[2]:
            parts.append(chr(int(match[2], 8) & 0xFF))
        elif match[3] in _ESCAPES:
            parts.append(_ESCAPES[match[3]])
        else:
            return None
    parts.append(text[end:])
    whole = "".join(parts)
    return encode(whole, DataType.VISIBLE_STRING) if max(whole, default="") <= "\xff" else None


def _from_base64(text: str, *, even: bool) -> bytes | None:
    try:
        data = binascii.a2b_base64(text.encode("ascii"), strict_mode=True)
    except ValueError:
        return None
    return None if even and len(data) % 2 else data


def _from_hex(text: str) -> bytes | None:
    try:
        return bytes.fromhex(text)
    except ValueError:
        return None
