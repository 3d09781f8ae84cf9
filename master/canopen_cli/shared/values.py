"""Objects and their values: from what a user types, and to what is shown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from canopen_cli.shared.problem import usage
from canopen_data.eds.writer_values import bytes_text
from canopen_proto.datatypes import DataType, Value, is_number, real_of, text_for_people, vanishes
from canopen_proto.dictionary import Object, ObjectDictionary, ObjectNotFoundError, Variable
from canopen_proto.dictionary.standard import find_standard
from canopen_proto.indices import COMMUNICATION_AREA
from canopen_proto.sdo.client import AUTO_BLOCK, Block

_TRUTH: Final = {"true": True, "yes": True, "on": True, "1": True, "false": False, "no": False, "off": False, "0": False}

BYTES: Final = "bytes"
"""The --type for the bytes of any object as they go over the wire, which files hold."""
TYPES: Final = {
    **{f"u{bits}": DataType[f"UNSIGNED{bits}"] for bits in (8, 16, 24, 32, 40, 48, 56, 64)},
    **{f"i{bits}": DataType[f"INTEGER{bits}"] for bits in (8, 16, 24, 32, 40, 48, 56, 64)},
    "bool": DataType.BOOLEAN,
    "f32": DataType.REAL32,
    "f64": DataType.REAL64,
    "text": DataType.VISIBLE_STRING,
    BYTES: DataType.OCTET_STRING,
}
"""The values of --type, for objects that the dictionary lacks."""


def place_text(variable: Variable) -> str:
    """Return index and subindex as all outputs show them: 6041:00."""
    return f"{variable.index:04X}:{variable.subindex:02X}"


def object_json(variable: Variable) -> dict[str, Any]:
    """Return how an object is named in a JSON document."""
    return {"index": variable.index, "sub": variable.subindex, "name": variable.name}


def value_text(variable: Variable, value: Value) -> str:
    """Return a value for people. A text of a device is read as UTF-8 if it is valid, else as Latin-1."""
    if isinstance(value, bytes):
        return value.hex(" ") if len(value) <= 64 else f"{value[:64].hex(' ')} ... ({len(value)} bytes)"
    if isinstance(value, str):
        return repr(text_for_people(value, variable.data_type))
    return str(value)


def hex_text(variable: Variable, value: Value) -> str:
    """Return a whole number in hexadecimal with all its digits; the bytes of a text or REAL whose text is not exact; "" for
    anything else."""
    if not isinstance(value, int) or isinstance(value, bool):
        return "" if isinstance(value, bytes) else bytes_text(variable, value) or ""
    bits = variable.bit_length or 32
    return f"0x{value & (1 << bits) - 1:0{bits // 4}X}"


def physical(variable: Variable, value: Value) -> float | None:
    """Return the physical value in the object's unit; None if no side file gives a unit."""
    if not variable.unit and variable.factor == 1.0:
        return None
    return value * variable.factor if isinstance(value, int | float) and not isinstance(value, bool) else None


def physical_text(variable: Variable, value: Value) -> str:
    """Return the physical value for people: "12.5 deg"; "" if there is none."""
    number = physical(variable, value)
    return "" if number is None else f"{number:.10g} {variable.unit}".rstrip()


def as_json(variable: Variable, value: Value) -> Any:
    """Return the value of an object for a JSON document: a text as people read it, all else by `plain_json`."""
    return text_for_people(value, variable.data_type) if isinstance(value, str) else plain_json(value)


def plain_json(value: Value) -> Any:
    """Return a value for a JSON document: bytes as hexadecimal text, times as text. (`json_text` takes care of NaN.)"""
    if isinstance(value, bytes):
        return value.hex()
    return value if isinstance(value, int | float | str) else str(value)


def block_of(variable: Variable, block: bool | None) -> Block:
    """Return what --block means for an object. Without it a number is never read in blocks: the device might not know them."""
    if block is not None:
        return block
    return "auto" if variable.size is None or variable.size > AUTO_BLOCK else False


def find_object(dictionary: ObjectDictionary, key: str, type_name: str | None) -> Variable:
    """Return the object that a key names, or that --type describes. A communication object that the dictionary lacks is that
    of the standard. Raises ObjectNotFoundError, CommandError."""
    try:
        return dictionary.variable(key)
    except ObjectNotFoundError as unknown:
        index, _, subindex = key.lower().removeprefix("0x").replace(".", ":").partition(":")
        try:
            place = int(index, 16), int(subindex or "0", 16)
        except ValueError:
            raise unknown from None
        if not (0 < place[0] <= 0xFFFF and place[1] <= 0xFF and len(index) == 4):
            raise unknown from None
        standard = find_standard(*place) if place[0] in COMMUNICATION_AREA else None
        if type_name is None and standard is not None:
            return standard
        if type_name is None:
            tries = [
                "-e FILE    (the EDS or DCF of the device, which may name it)",
                f"--type u16 (or another type) to reach {key} all the same",
            ]
            record = dictionary.objects.get(place[0])
            if record is not None and not subindex:
                tries.insert(0, f"{index.upper()}:{min(record.variables):02X}    (a subindex of it)")
            raise usage("CO302", str(unknown), tries=tries) from None
        return Object.of(key, [Variable(*place, key, TYPES[type_name])]).variables[place[1]]


def parse_value(dictionary: ObjectDictionary, variable: Variable, text: str) -> Value:
    """Return the value that a user typed for an object: a constant's name, a number, a text, or bytes in hexadecimal.

    Raises ConstantNotFoundError for an unknown name, else CommandError. Range and limits are not checked here.
    """
    if any(constant.name == text for constant in dictionary.constants_of(variable)):
        return dictionary.value_from(variable, text)
    kind = variable.data_type
    if kind is DataType.BOOLEAN and text.lower() in _TRUTH:
        return _TRUTH[text.lower()]
    if is_number(kind):
        number = _number(text)
        if number is not None and vanishes(number, kind):
            raise usage("CO304", f"{text} is too small for {variable.label}: it would become 0", seen="nothing was sent")
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
        # People type "007", which is no literal of Python. "1.5" for a whole number is refused later, with its range.
        if text.lstrip("+-").isdecimal():
            return int(text)
        float(text)
    except ValueError:
        return None
    try:
        return real_of(text)
    except ValueError as error:
        raise usage("CO304", str(error), seen="nothing was sent") from None


def identity_json(identity: Sequence[int | None]) -> dict[str, int | None]:
    """Return the numbers of an identity (0x1018), or of an LSS address, for --json."""
    return dict(zip(("vendor_id", "product_code", "revision_number", "serial_number"), identity, strict=True))
