"""Read numbers, flags and values as an XDD writes them; each fault is a finding with its place.

Values are written as in an EDS (eds/numbers.py); a BOOL may also be true or false, as in XML Schema.
"""

from __future__ import annotations

import re
from typing import Final

from canopen_data.eds.ini import quoted
from canopen_data.eds.numbers import TEXTS, read_number, read_value
from canopen_data.findings import LOST_SETTING, Severity
from canopen_data.xdd.elements import Element, XddFindings
from canopen_proto.datatypes import DataType, Value, is_number

HEXADECIMAL: Final = re.compile(r"(?:0[xX])?([0-9A-Fa-f]{1,16})")
_FLAGS: Final = {"true": True, "1": True, "false": False, "0": False, "": False}
_TRUTH: Final = {"true": "1", "false": "0"}


def hexadecimal_of(
    element: Element, attribute: str, findings: XddFindings, *, most: int, least: int = 0, severity: Severity = Severity.WARNING
) -> int | None:
    """Return a hexadecimal attribute, with or without 0x; None, with a finding, if it is missing, no number, or outside
    least..most. severity: of the finding."""
    text = element.get(attribute)
    match = HEXADECIMAL.fullmatch(text)
    if match is not None and least <= (number := int(match[1], 16)) <= most:
        return number
    fault = "is not a hexadecimal number" if match is None else f"is outside 0x{least:X}..0x{most:X}"
    message = f"{attribute} {quoted(text)!r} {fault}" if text else f"{attribute} is missing"
    left_out = "; left out" if severity is Severity.ERROR else ""
    findings.about(severity, "number", f"{message}{left_out}", element, attribute)
    return None


def number_of(text: str, findings: XddFindings, element: Element, attribute: str = "", *, most: int) -> int | None:
    """Return a number from 0, as in an EDS; None, with a finding, if it is not a number or more than `most`."""
    number, remark = read_number(text.strip())
    if number is not None and not 0 <= number <= most:
        number, remark = None, f"is outside 0..{most}"
    if remark:
        findings.warning("number", f"{attribute or element.name} {quoted(text)!r}: {remark}", element, attribute)
    return number


def flag_of(element: Element | None, attribute: str, findings: XddFindings) -> bool:
    """Return a flag of XML Schema: true, false, 1, 0. False if there is none."""
    text = "" if element is None else element.get(attribute).lower()
    if element is not None and text not in _FLAGS:
        findings.warning("flag", f"{attribute} {quoted(text)!r} is neither true nor false; taken as false", element, attribute)
    return _FLAGS.get(text, False)


def value_of(
    text: str, data_type: DataType, what: str, findings: XddFindings, element: Element, attribute: str = ""
) -> tuple[Value | None, bool]:
    """Return a value, and whether the node-ID is added to it; None, with a finding, if it is not a value. An empty text gives
    None."""
    if data_type is DataType.BOOLEAN:
        text = _TRUTH.get(text.strip().lower(), text)
    is_text = data_type in TEXTS
    value, adds_node_id, remark, lost = read_value(text if is_text else text.strip(), data_type)
    if remark:
        code = LOST_SETTING if lost and what == "actualValue" else "value"
        findings.about(Severity.ERROR if lost else Severity.WARNING, code, f"{what}: {remark}", element, attribute)
    return value, adds_node_id


def limit_of(
    text: str, data_type: DataType, what: str, findings: XddFindings, element: Element, attribute: str
) -> int | float | None:
    """Return a limit; None if there is none. A limit of a type that is not a number has no effect, but the linter is to see
    it."""
    text = text.strip()
    if not text:
        return None
    adds_node_id = False
    value: Value | None
    if is_number(data_type):
        value, adds_node_id, remark, _ = read_value(text, data_type)
    else:
        value, remark = read_number(text)
    if adds_node_id:
        value, remark = None, f"{quoted(text)!r} depends on the node-ID, which a limit cannot; left out"
    if remark:
        findings.warning("limit", f"{what}: {remark}", element, attribute)
    return value if isinstance(value, int | float) else None
