"""Values as the texts of an EDS: the way back of numbers.py.

Theory of operation
-------------------
Numbers have the form that they have in the files of the standard: 0x and all digits where bits or digits mean something (device
type, identity, COB-IDs, mapping entries: the UNSIGNED32 of the communication profile area, but for the times), decimal elsewhere.
Octets (OCTET_STRING, DOMAIN) are pairs of hexadecimal digits. A line holds no line break, and blanks at the ends of a text are
not its own: `one_line` turns the first into blanks and takes the second off, and this is all that a file can lose.

Source: CiA 306-1 v1.4.0, 4.2 (entry value interpretation).
"""

from __future__ import annotations

import math
import re
from typing import Final

from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary.objects import Variable

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
