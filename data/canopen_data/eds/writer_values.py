"""Values as the texts of an EDS: the way back of numbers.py.

Theory of operation
-------------------
Numbers have the form that they have in the files of the standard: 0x and all digits where bits or digits mean something (device
type, identity, COB-IDs, mapping entries: the UNSIGNED32 of the communication profile area, but for the times), decimal elsewhere.
Octets (OCTET_STRING, DOMAIN) are pairs of hexadecimal digits. A line holds no line break, and blanks at the ends of a text are
not its own: `one_line` turns the first into blanks and takes the second off.

So ParameterValue cannot carry every value: no empty text, no octets of length 0, no NaN, no text with line breaks, control
characters or blanks at its ends, and other tools disagree about characters beyond ASCII. For these the file has one more key
(`BYTES_KEY`, ours; CiA 306 tools skip it), which holds the bytes as SDO carries them. ParameterValue stands beside it as other
tools and people can read it, or is left out. If somebody changes ParameterValue later, the two do not agree any more, and
ParameterValue counts.

Source: CiA 306-1 v1.4.0, 4.2 (entry value interpretation).
"""

from __future__ import annotations

import math
import re
from typing import Final

from canopen_proto.datatypes import DataType, Value, ValueRangeError, text_for_people
from canopen_proto.dictionary.objects import Variable

BYTES_KEY: Final = "_ParameterBytes"
"""Key of the bytes of a configured value that ParameterValue cannot carry."""
NOT_READ_KEY: Final = "_NotRead"
"""Key of the reason why a backup has no value of an object."""

_PLAIN_TEXT: Final = re.compile(r"[!-~](?:[ -~]*[!-~])?")
_LINE_END: Final = re.compile(r"\r\n|\r|\n")
_COMMUNICATION: Final = range(0x1000, 0x2000)
_TIMES: Final = (0x1006, 0x1007, 0x1013)
"""UNSIGNED32 of the communication profile area that are microseconds."""


def value_text(variable: Variable, value: Value, adds_node_id: bool) -> str:
    """A default or configured value. "" for what has no text: an empty string, no octets, a REAL that is no number (NaN)."""
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
    """The bytes of a value that `value_text` cannot carry, as pairs of hexadecimal digits; None where it carries the value."""
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
    except ValueRangeError:  # no object can hold it, so no bytes stand for it
        return None


def text_beside(value: Value, data_type: DataType) -> str:
    """What ParameterValue says where `bytes_text` has the value: a text without what a line cannot hold; "" for all else."""
    if not isinstance(value, str):
        return ""
    shown = one_line(text_for_people(value, data_type))
    return "".join(each if each.isprintable() else " " if each.isspace() else "?" for each in shown)


def limit_text(variable: Variable, limit: int | float | None) -> str:
    """A limit, in the form of the values; "" for None."""
    if limit is None:
        return ""
    return _integer(variable, limit) if isinstance(limit, int) else repr(limit)


def one_line(text: str) -> str:
    """The text as one line of a file can hold it."""
    return _LINE_END.sub(" ", text).strip()


def _integer(variable: Variable, value: int) -> str:
    digits = 8 if variable.data_type is DataType.UNSIGNED32 else 0
    if digits and value >= 0 and variable.index in _COMMUNICATION and variable.index not in _TIMES:
        return f"0x{value:08X}"
    return str(int(value))
