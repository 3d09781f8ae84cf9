"""Read numbers and values as an EDS writes them.

CiA 306-1 v1.4.0, 4.2: a number is decimal, hexadecimal with 0x, or octal with a leading 0. A value may depend on the node-ID:
`$NODEID+0x180`, or the other way round. Text is written as it is, octets as pairs of hexadecimal digits.

Other forms in devices' files are read if only one meaning is likely, with a remark, which the reader reports as a finding:

- `08` is not octal, so it is read as decimal; `010` is octal, so it is 8, though the author may have meant 10;
- `0000 0080h` is hexadecimal; its digits may be in groups;
- text after `#` or `;` is a comment, except in a text, which may hold both;
- a signed number may be written as its two's complement (0xFFFFFFFF is -1); an unsigned one as a negative number (-1);
- a REAL may be written as its bits: 0x and all its digits (0x3F800000 is 1.0).

A time is a number of 48 bits, or six octets. Any other text, or one that does not fit its type, gives no value, and the remark is
an error.
"""

from __future__ import annotations

import math
import re
import struct
from typing import Final, TypeAlias

from canopen_data.eds.ini import quoted
from canopen_proto.datatypes import DataType, Value, ValueRangeError, decode, encode, range_of, real_of, vanishes
from canopen_proto.frame import MAX_NODE_ID

_NUMBER: Final = re.compile(r"([+-]?)(?:0[xX]([0-9A-Fa-f]{1,32})|([0-9]{1,40}))", re.ASCII)
_OCTAL: Final = re.compile(r"0[0-7]+", re.ASCII)
_SUFFIXED: Final = re.compile(r"([0-9A-Fa-f]{1,32})[hH]", re.ASCII)
_NODE_ID: Final = re.compile(r"\$NODEID", re.IGNORECASE | re.ASCII)
_REAL: Final = re.compile(
    r"[+-]?(?:[0-9]{1,400}(?:\.[0-9]{0,400})?|\.[0-9]{1,400})(?:[eE][+-]?[0-9]{1,9})?|[+-]?inf(?:inity)?",
    re.IGNORECASE | re.ASCII,
)
_BITS: Final = re.compile(r"0[xX]([0-9A-Fa-f]+)", re.ASCII)
_NO_DATA: Final = ("0", "0x0", "0x00")
"""Texts that tools write as the default of a DOMAIN, which has no default."""
_COMMENT: Final = re.compile(r"[#;]")
_CUT: Final = "the comment after it was left out; a comment has a line of its own"

_LIMITS: Final = {data_type: range_of(data_type) for data_type in DataType}
TEXTS: Final = (DataType.VISIBLE_STRING, DataType.UNICODE_STRING)
_REALS: Final = {DataType.REAL32: struct.Struct(">f"), DataType.REAL64: struct.Struct(">d")}
_TIMES: Final = (DataType.TIME_OF_DAY, DataType.TIME_DIFFERENCE)
_WORDS: Final = {"true": 1, "false": 0}


Reading: TypeAlias = tuple[Value | None, bool, str, bool]
"""The result of reading a text: the value (None = nothing); whether the node-ID is added to it; a remark on what is odd about it,
or ""; whether a value was lost, so that there is none."""

NOTHING: Final[Reading] = (None, False, "", False)


def read_number(text: str) -> tuple[int | None, str]:
    """Return a whole number, and a remark on what is odd about it ("" = nothing). None, with a remark, if it is not a number.
    text: of an entry."""
    match = _NUMBER.fullmatch(text)
    if match is not None:
        sign, digits, decimal = match.groups()
        if digits is not None:
            number, remark = int(digits, 16), ""
        elif decimal[0] != "0" or decimal == "0":
            number, remark = int(decimal), ""
        elif _OCTAL.fullmatch(decimal):
            number = int(decimal, 8)
            remark = "" if number < 8 else f"a leading 0 means octal; read as {number}"
        else:
            number = int(decimal)
            remark = f"a leading 0 means octal, which it cannot be; read as decimal {number}" if number else ""
        return (-number if sign == "-" else number), remark
    bare = text.strip()
    cut = _COMMENT.search(bare)
    if cut is not None and cut.start():
        number_before, _ = read_number(bare[: cut.start()].rstrip())
        if number_before is not None:
            return number_before, _CUT
    suffixed = _SUFFIXED.fullmatch("".join(bare.split()))
    if suffixed is not None:
        return int(suffixed[1], 16), "a hexadecimal number begins with 0x"
    return None, "is not a number"


def read_value(text: str, data_type: DataType) -> Reading:
    """Return a default or configured value of that type. An empty text gives NOTHING."""
    if not text:
        return NOTHING
    cut = None if data_type in TEXTS else _COMMENT.search(text)
    if cut is not None and cut.start():
        reading = read_value(text[: cut.start()].rstrip(), data_type)
        return reading if reading[3] else (*reading[:2], _with(text, _CUT), False)
    limits = _LIMITS[data_type]
    if limits is not None:
        return _integer(text, data_type, *limits)
    if data_type in TEXTS:
        return text, False, "", False
    if data_type in _REALS:
        return _real(text, data_type)
    if data_type in _TIMES and (time := _time(text, data_type)) is not None:
        return time, False, "", False
    if data_type is DataType.DOMAIN and text in _NO_DATA:
        return NOTHING
    try:
        return decode(bytes.fromhex(text[2:] if text[:2] in ("0x", "0X") else text), data_type), False, "", False
    except ValueError:  # ValueRangeError, or no digits
        pass
    return _lost(text, f"is no {data_type.name}{'' if data_type in _TIMES else ' in pairs of hexadecimal digits'}")


def _integer(text: str, data_type: DataType, low: int, high: int) -> Reading:
    adds_node_id = "$" in text
    number, remark = _relative(text) if adds_node_id else read_number(text)
    if number is None:
        if data_type is not DataType.BOOLEAN or text.lower() not in _WORDS:
            return _lost(text, remark)
        number, remark = _WORDS[text.lower()], "a BOOLEAN is 0 or 1"
    is_relative = adds_node_id and data_type is not DataType.BOOLEAN
    least, most = (low - MAX_NODE_ID, high - 1) if is_relative else (low, high)  # one node-ID at least gives a value of the type
    if not least <= number <= most:
        size = high - low + 1
        if low < 0 and high < number < size:
            number -= size
            if text[:2].lower() != "0x" and not remark:
                remark = f"read as {number}, its two's complement"
        elif low == 0 and -size // 2 <= number < 0 and data_type is not DataType.BOOLEAN and not is_relative:
            number += size
            remark = f"an {data_type.name} is not negative; read as 0x{number:X}"
        else:
            every = ", whatever the node-ID" if is_relative else ""
            return _lost(text, f"is outside {low}..{high} ({data_type.name}){every}")
    if data_type is DataType.BOOLEAN:
        return _lost(text, "depends on the node-ID") if adds_node_id else (bool(number), False, _with(text, remark), False)
    return number, adds_node_id, remark and _with(text, remark), False


def _with(text: str, remark: str) -> str:
    return f"{quoted(text)!r}: {remark}" if remark else ""


def _relative(text: str) -> tuple[int | None, str]:
    """Return the number that is added to the node-ID."""
    parts = _NODE_ID.split(text)
    if len(parts) != 2:
        return None, "is not a number"
    before, behind = parts[0].strip(), parts[1].strip()
    if not before and not behind:
        return 0, ""
    if not before and behind[0] in "+-":
        number, remark = read_number(behind[1:].strip())
        return (-number if number is not None and behind[0] == "-" else number), remark
    if before[-1:] == "+" and not behind:
        return read_number(before[:-1].strip())
    if before[-1:] == "+":
        return None, "is not a number"
    return None, "is neither $NODEID plus a number nor a number plus $NODEID"


def _real(text: str, data_type: DataType) -> Reading:
    remark = ""
    if _REAL.fullmatch(text):
        try:
            value = real_of(text)
        except ValueError:
            return _lost(text, f"is too {'large' if float(text) else 'small'} for {data_type.name}")
    else:
        bits = _BITS.fullmatch(text)
        layout = _REALS[data_type]
        if bits is not None and len(bits[1]) == 2 * layout.size:
            (value,) = layout.unpack(bytes.fromhex(bits[1]))
            remark = f"{quoted(text)!r}: read as the bits of {value!r}"
        else:
            number, remark = read_number(text)
            if number is None:
                return _lost(text, f"is no {data_type.name}")
            value = float(number)
            remark = f"{quoted(text)!r}: {remark or f'read as {value!r}'}"
    if vanishes(value, data_type):
        return _lost(text, f"is too small for {data_type.name}")
    try:
        encode(value, data_type)
    except ValueRangeError:
        return _lost(text, f"is too large for {data_type.name}")
    return _lost(text, "is not a number (NaN)") if math.isnan(value) else (value, False, remark, False)


def _time(text: str, data_type: DataType) -> Value | None:
    """Return a time written as a number of 48 bits, as 0x000000000000."""
    number = int(text, 16) if (bits := _BITS.fullmatch(text)) is not None and len(bits[1]) <= 12 else None
    if number is None:
        return None
    try:
        return decode(number.to_bytes(6, "little"), data_type)
    except ValueRangeError:
        return None


def _lost(text: str, reason: str) -> Reading:
    return None, False, f"{quoted(text)!r} {reason}; left out", True
