"""Numbers, flags and values as an XDD writes them; what cannot be read is a finding with its place."""

from __future__ import annotations

import re
from typing import Final

from canopen_proto.datatypes import DataType, Value, ValueRangeError, decode, encode, is_number, range_of
from canopen_proto.dictionary.eds.ini import quoted
from canopen_proto.dictionary.findings import Severity
from canopen_proto.dictionary.xdd.elements import Element, XddFindings

HEXADECIMAL: Final = re.compile(r"(?:0[xX])?([0-9A-Fa-f]{1,16})")
_NUMBER: Final = re.compile(r"([+-]?)(?:0[xX]([0-9A-Fa-f]{1,32})|([0-9]{1,40}))")
_NODE_ID: Final = re.compile(r"\$NODEID", re.IGNORECASE)
_FLAGS: Final = {"true": True, "1": True, "false": False, "0": False, "": False}


def hexadecimal_of(
    element: Element, attribute: str, findings: XddFindings, *, most: int, least: int = 0, severity: Severity = Severity.WARNING
) -> int | None:
    """An attribute in hexadecimal, with or without 0x; None, and a finding, where it is none or outside least..most."""
    text = element.get(attribute)
    match = HEXADECIMAL.fullmatch(text)
    if match is not None and least <= (number := int(match[1], 16)) <= most:
        return number
    what = f"{attribute} {quoted(text)!r} is" if text else f"{attribute} is missing:"
    if match is not None:
        fault = f"{what} outside 0x{least:X}..0x{most:X}"
    else:
        fault = f"{what} no hexadecimal number" if text else f"{attribute} is missing"
    left_out = "; left out" if severity is Severity.ERROR else ""
    findings.about(severity, "number", f"{fault}{left_out}", element, attribute)
    return None


def number_of(text: str, findings: XddFindings, element: Element, attribute: str = "", *, most: int) -> int | None:
    """A number from 0, decimal or with 0x; None, and a finding, where it is none or more than `most`."""
    number = _integer(text.strip())
    if number is not None and 0 <= number <= most:
        return number
    what = attribute or element.name
    fault = "is no number" if number is None else f"is outside 0..{most}"
    findings.warning("number", f"{what} {quoted(text)!r} {fault}", element, attribute)
    return None


def flag_of(element: Element | None, attribute: str, findings: XddFindings) -> bool:
    """A flag of XML Schema: true, false, 1, 0. False where there is none."""
    text = "" if element is None else element.get(attribute).lower()
    if element is not None and text not in _FLAGS:
        findings.warning("flag", f"{attribute} {quoted(text)!r} is neither true nor false; taken as false", element, attribute)
    return _FLAGS.get(text, False)


def value_of(
    text: str, data_type: DataType, what: str, findings: XddFindings, element: Element, attribute: str = ""
) -> tuple[Value | None, bool]:
    """A value as CiA 306 writes it, and whether the node-ID is added to it; None, and a finding, where it is none."""
    value, adds_node_id, fault = read_value(text, data_type)
    if value is not None:
        try:
            encode(value, data_type, what)
        except ValueRangeError as error:  # a REAL32 that is too large, a text with characters that no device has
            value, fault = None, f"cannot be held by it: {error}"
    if fault:
        findings.error("value", f"{what} {quoted(text)!r} {fault}; left out", element, attribute)
    return value, adds_node_id


def limit_of(
    text: str, data_type: DataType, what: str, findings: XddFindings, element: Element, attribute: str
) -> int | float | None:
    """A limit of a number; None where there is none, or where the object is no number."""
    if not text.strip() or not is_number(data_type):
        return None
    value, adds_node_id, fault = read_value(text, data_type)
    if adds_node_id:
        fault = "depends on the node-ID, which a limit cannot"
    if fault:
        findings.warning("limit", f"{what} {quoted(text)!r} {fault}; left out", element, attribute)
        return None
    return value if isinstance(value, int | float) else None


def _integer(text: str) -> int | None:
    match = _NUMBER.fullmatch(text)
    if match is None:
        return None
    number = int(match[2], 16) if match[2] is not None else int(match[3])
    return -number if match[1] == "-" else number


def read_value(text: str, data_type: DataType) -> tuple[Value | None, bool, str]:
    """A value, whether the node-ID is added, and what is wrong with it ("" = nothing). An empty one is None."""
    bare = text.strip()
    if data_type in (DataType.VISIBLE_STRING, DataType.UNICODE_STRING):
        return text, False, ""
    if not bare:
        return None, False, ""
    if data_type in (DataType.REAL32, DataType.REAL64):
        try:
            return float(bare), False, ""
        except ValueError:
            return None, False, f"is no {data_type.name}"
    limits = range_of(data_type)
    if limits is None:
        return _bytes(bare, data_type)
    rest, adds = _NODE_ID.subn("", bare, count=1)
    number = _integer((rest.replace(" ", "").strip("+") or "0") if adds else bare)
    if number is None:
        number = {"true": 1, "false": 0}.get(bare.lower()) if data_type is DataType.BOOLEAN else None
    if number is None:
        return None, False, "is no number"
    low, high = limits
    if low < 0 and high < number <= 2 * high + 1:
        number -= 2 * (high + 1)  # two's complement
    if not low <= number <= high:
        return None, False, f"is outside {low}..{high} ({data_type.name})"
    return (bool(number) if data_type is DataType.BOOLEAN else number), bool(adds), ""


def _bytes(text: str, data_type: DataType) -> tuple[Value | None, bool, str]:
    try:
        return decode(bytes.fromhex(text.removeprefix("0x")), data_type), False, ""
    except (ValueError, ValueRangeError):
        return None, False, f"is no {data_type.name} in hexadecimal"
