"""Write values as texts of an EDS: the inverse of numbers.py.

Numbers have the form of the standard's examples: 0x and all digits where single bits or digits have a meaning (device type,
identity, COB-IDs, mapping entries: the UNSIGNED32 of the communication profile area, except for times), decimal elsewhere. Octets
(OCTET_STRING, DOMAIN) are pairs of hexadecimal digits. A line cannot hold line breaks, nor blanks at the ends of a text:
`one_line` turns the breaks into blanks and removes the blanks at the ends.

So ParameterValue cannot carry an empty text, octets of length 0, NaN, or a text with line breaks, control characters or blanks at
its ends; and other tools disagree about characters beyond ASCII. For these values the file has one more key (`BYTES_KEY`, ours;
CiA 306 tools skip it), which holds the bytes as SDO carries them. ParameterValue is added in a form that other tools and people
can read, or is left out. If somebody changes ParameterValue later, the two disagree, and ParameterValue counts.

Source: CiA 306-1 v1.4.0, 4.2 (entry value interpretation).
"""

from __future__ import annotations

import math
import re
from typing import Final

from canopen_data.eds.encodings import LINE_END
from canopen_data.eds.numbers import TEXTS, read_number, read_value
from canopen_proto import indices
from canopen_proto.datatypes import DataType, Value, ValueRangeError, is_number, text_for_people
from canopen_proto.dictionary.objects import Variable

BYTES_KEY: Final = "_ParameterBytes"
"""Key of the bytes of a configured value that ParameterValue cannot carry."""
NOT_READ_KEY: Final = "_NotRead"
"""Key of the reason why a backup has no value of an object."""

_PLAIN_TEXT: Final = re.compile(r"[!-~](?:[ -~]*[!-~])?")
_TIMES: Final = (indices.COMMUNICATION_CYCLE_PERIOD, indices.SYNCHRONOUS_WINDOW_LENGTH, indices.HIGH_RESOLUTION_TIME_STAMP)
"""UNSIGNED32 of the communication profile area that are microseconds."""


def value_text(variable: Variable, value: Value, adds_node_id: bool) -> str:
    """Return a default or configured value as text. "" for an empty string, no octets, and NaN, which have no text. adds_node_id:
    the value is relative to the node-ID."""
    if isinstance(value, str):
        return one_line(value)
    if isinstance(value, bytes | bytearray | memoryview):
        return bytes(value).hex(" ").upper()
    if isinstance(value, int):
        if adds_node_id:
            return f"$NODEID+0x{value:X}" if value >= 0 else f"$NODEID{value}"
        return _integer(variable, value)
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(value)
    return f"0x{int.from_bytes(variable.encode(value), 'little'):012X}"


def bytes_text(variable: Variable, value: Value) -> str | None:
    """Return the bytes of a value that `value_text` cannot carry, as pairs of hexadecimal digits; None if it can."""
    if isinstance(value, str):
        is_plain = _PLAIN_TEXT.fullmatch(value) is not None
    elif isinstance(value, bytes | bytearray | memoryview):
        is_plain = len(value) > 0
    else:
        is_plain = not (isinstance(value, float) and math.isnan(value))
    if is_plain:
        return None
    try:
        return variable.encode(value).hex(" ").upper()
    except ValueRangeError:  # no object can hold it, so it has no bytes
        return None


def text_beside(value: Value, data_type: DataType) -> str:
    """Return the ParameterValue beside `bytes_text`: a text without characters that a line cannot hold; "" for all other
    types."""
    if not isinstance(value, str):
        return ""
    shown = one_line(text_for_people(value, data_type))
    return "".join(each if each.isprintable() else " " if each.isspace() else "?" for each in shown)


def limit_text(variable: Variable, limit: int | float | None) -> str:
    """Return a limit, in the form of the values; "" for None."""
    if limit is None:
        return ""
    return _integer(variable, limit) if isinstance(limit, int) else repr(limit)


def check_kept(variable: Variable) -> None:
    """Raise ValueRangeError if a number or octets of the variable would not be read again as they are. Of texts only the type
    is looked at; a default of NaN, or without octets, has no text."""
    given = (
        ("default", variable.default, variable.adds_node_id),
        ("configured", variable.configured, variable.configured_adds_node_id),
    )
    for what, value, adds_node_id in given:
        if value is None or value != value or (isinstance(value, str) and variable.data_type in TEXTS):
            continue
        text = value_text(variable, value, adds_node_id)
        found, _, remark, _ = read_value(text, variable.data_type)
        if text and found != value:
            raise _not_kept(variable, what, value, remark)
    for what, limit in (("low_limit", variable.low_limit), ("high_limit", variable.high_limit)):
        if limit is not None:
            text = limit_text(variable, limit)
            found, remark = read_value(text, variable.data_type)[::2] if is_number(variable.data_type) else read_number(text)
            if found != limit:
                raise _not_kept(variable, what, limit, remark)
    if not variable.factor or not math.isfinite(variable.factor):
        raise _not_kept(variable, "factor", variable.factor, "a factor is a number other than 0")


def _not_kept(variable: Variable, what: str, value: Value, remark: str) -> ValueRangeError:
    reason = f": {remark}" if remark else ""
    return ValueRangeError(f"{variable.label}: {what} {value!r} cannot be kept in the file ({variable.data_type.name}){reason}")


def one_line(text: str) -> str:
    """Return the text in a form that one line of a file can hold."""
    return LINE_END.sub(" ", text).strip()


def _integer(variable: Variable, value: int) -> str:
    digits = 8 if variable.data_type is DataType.UNSIGNED32 else 0
    if digits and value >= 0 and variable.index in indices.COMMUNICATION_AREA and variable.index not in _TIMES:
        return f"0x{value:08X}"
    return str(int(value))
