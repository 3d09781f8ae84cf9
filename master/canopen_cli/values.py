"""Values of objects as text: what a user types, and what he gets to see."""

from __future__ import annotations

from typing import Any, Final

from canopen_cli.problem import usage
from canopen_data.eds.writer_values import bytes_text
from canopen_proto.datatypes import DataType, Value, is_number, text_for_people
from canopen_proto.dictionary import ObjectDictionary, Variable

_TRUTH: Final = {"true": True, "yes": True, "on": True, "1": True, "false": False, "no": False, "off": False, "0": False}

BYTES: Final = "bytes"
"""The --type of any object as it goes over the wire: what files hold."""
TYPES: Final = {
    **{f"u{bits}": DataType[f"UNSIGNED{bits}"] for bits in (8, 16, 24, 32, 40, 48, 56, 64)},
    **{f"i{bits}": DataType[f"INTEGER{bits}"] for bits in (8, 16, 24, 32, 40, 48, 56, 64)},
    "bool": DataType.BOOLEAN,
    "f32": DataType.REAL32,
    "f64": DataType.REAL64,
    "text": DataType.VISIBLE_STRING,
    BYTES: DataType.OCTET_STRING,
}
"""What --type takes, for objects that the dictionary does not have."""


def place_text(variable: Variable) -> str:
    """Index and subindex as all outputs show them: 6041:00."""
    return f"{variable.index:04X}:{variable.subindex:02X}"


def value_text(variable: Variable, value: Value) -> str:
    """A value for people. A text of a device is UTF-8 where it is valid, else Latin-1."""
    if isinstance(value, bytes):
        return value.hex(" ") if len(value) <= 64 else f"{value[:64].hex(' ')} ... ({len(value)} bytes)"
    if isinstance(value, str):
        return repr(text_for_people(value, variable.data_type))
    return str(value)


def hex_text(variable: Variable, value: Value) -> str:
    """A whole number as the wire has it, with all its digits; the bytes of a text or REAL that its notation for people does not
    tell exactly; "" for anything else."""
    if not isinstance(value, int) or isinstance(value, bool):
        return "" if isinstance(value, bytes) else bytes_text(variable, value) or ""
    bits = variable.bit_length or 32
    return f"0x{value & (1 << bits) - 1:0{bits // 4}X}"


def physical(variable: Variable, value: Value) -> float | None:
    """The physical value in the object's unit; None where nobody has said what that is."""
    if not variable.unit and variable.factor == 1.0:
        return None
    return value * variable.factor if isinstance(value, int | float) and not isinstance(value, bool) else None


def physical_text(variable: Variable, value: Value) -> str:
    """The same for people: "12.5 deg"; "" where there is none."""
    number = physical(variable, value)
    return "" if number is None else f"{number:.10g} {variable.unit}".rstrip()


def as_json(variable: Variable, value: Value) -> Any:
    """A value of an object in a JSON document: a text as people read it, all else as `plain_json` has it."""
    return text_for_people(value, variable.data_type) if isinstance(value, str) else plain_json(value)


def plain_json(value: Value) -> Any:
    """A value in a JSON document: bytes as hexadecimal text, times as text. (`json_text` knows what to do with NaN.)"""
    if isinstance(value, bytes):
        return value.hex()
    return value if isinstance(value, int | float | str) else str(value)


def parse_value(dictionary: ObjectDictionary, variable: Variable, text: str) -> Value:
    """What a user means by `text` for an object: a constant's name, a number, a text, or bytes in hexadecimal.

    A name that is no constant raises ConstantNotFound; other nonsense is a Problem. Range and limits are not looked at here.
    """
    if any(constant.name == text for constant in dictionary.constants_of(variable)):
        return dictionary.value_from(variable, text)
    kind = variable.data_type
    if kind is DataType.BOOLEAN and text.lower() in _TRUTH:
        return _TRUTH[text.lower()]
    if is_number(kind):
        number = _number(text)
        return dictionary.value_from(variable, text) if number is None else number
    if kind in (DataType.VISIBLE_STRING, DataType.UNICODE_STRING):
        return text
    if kind in (DataType.OCTET_STRING, DataType.DOMAIN):
        try:
            return bytes.fromhex(text.removeprefix("0x"))
        except ValueError:
            raise usage("CO304", f"{variable.label} takes bytes in hexadecimal, not {text!r}", tries=("01ff20",)) from None
    raise usage("CO304", f"{variable.label} is of type {kind.name}, which cannot be typed; {text!r} was not sent")


def _number(text: str) -> int | float | None:
    try:
        return int(text, 0)
    except ValueError:
        pass
    try:
        # "007" is no literal of Python, but what people type; "1.5" for a whole number is refused with its range later.
        return int(text) if text.lstrip("+-").isdecimal() else float(text)
    except ValueError:
        return None
