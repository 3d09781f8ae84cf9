"""`Meaning`: a frame of a bus in words, and the objects in it with their names and values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from canopen_proto.cia402.modes import describe_command
from canopen_proto.cia402.names import names_in_mode
from canopen_proto.cia402.objects import CONTROLWORD, STATUSWORD
from canopen_proto.datatypes import DataType, Value, ValueRangeError, decode
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.multiplexer import mux

MAX_SHOWN: Final = 32
"""The most bytes of a value that are shown."""

_NUMBERS: Final = (1, 2, 4, 8)


@dataclass(frozen=True)
class Shown:
    """An object in a frame, with its value if the frame shows one.

    node_id: of the device that has the object. name: "" if no dictionary tells it. value: bytes if the type is not known; None if
    the frame shows none. text: the value for people, with its names; "" without one. is_held: the device holds this value: it has
    sent it itself, or has confirmed that it was written.
    """

    node_id: int
    index: int
    subindex: int
    name: str
    value: Value | None
    text: str
    is_held: bool


class Meaning(NamedTuple):
    """A frame in words.

    service: "NMT", "SDO" and the like. node_id: its sender or receiver; 0 for all nodes, or for no node. objects: those of a PDO,
    in its order, or the one of an SDO transfer.
    """

    service: str
    node_id: int
    text: str
    objects: tuple[Shown, ...] = ()


def shown_of(
    dictionary: ObjectDictionary, node_id: int, index: int, subindex: int, data: bytes | None, *, is_held: bool
) -> Shown:
    """Return an object with the value in these bytes; None: without one."""
    variable = dictionary.get(index, subindex)
    name = variable.name if variable is not None else ""
    if data is None:
        return Shown(node_id, index, subindex, name, None, "", False)
    value: Value = data
    if variable is not None and _has_type(variable):
        try:
            value = decode(data, variable.data_type)
        except ValueRangeError:
            value = data
    return Shown(node_id, index, subindex, name, value, value_text(dictionary, index, subindex, data), is_held)


def object_text(dictionary: ObjectDictionary, index: int, subindex: int) -> str:
    """Return an object in words: "6041:00 statusword"."""
    variable = dictionary.get(index, subindex)
    return f"{index:04X}:{subindex:02X}" + (f" {variable.name}" if variable is not None else "")


def value_text(dictionary: ObjectDictionary, index: int, subindex: int, data: bytes) -> str:
    """Return a value in words, by its type and with its names; without a type as a number, or as bytes."""
    variable = dictionary.get(index, subindex)
    if variable is not None and _has_type(variable):
        try:
            value = decode(data, variable.data_type)
        except ValueRangeError:
            return f"{bytes_text(data)} (not of its type, {variable.data_type.name})"
        return shown_value(dictionary, index, subindex, value)
    if len(data) in _NUMBERS:
        return f"0x{int.from_bytes(data, 'little'):0{2 * len(data)}X}"
    return bytes_text(data)


def shown_value(dictionary: ObjectDictionary, index: int, subindex: int, value: Value) -> str:
    """Return a value with its names. Large numbers are hexadecimal too: this shows the parts of a COB-ID."""
    if isinstance(value, bytes):
        return bytes_text(value)
    variable = dictionary.get(index, subindex)
    notes = [] if variable is None else list(dictionary.names_of(variable, value))
    if mux(index, subindex) == STATUSWORD:
        notes = list(names_in_mode(notes, None))
    elif mux(index, subindex) == CONTROLWORD and isinstance(value, int) and (not notes or not value):
        notes = list(describe_command(value))  # the manual's name of 0 is the first half of a fault reset
    if isinstance(value, int) and value > 0xFF:
        notes.insert(0, f"0x{value:X}")
    return (repr(value) if isinstance(value, str) else str(value)) + (f" ({', '.join(notes)})" if notes else "")


def _has_type(variable: Variable) -> bool:
    """Return whether its values are more than bytes."""
    return variable.data_type not in (DataType.DOMAIN, DataType.OCTET_STRING)


def bytes_text(data: bytes) -> str:
    """Return bytes as text if they are text, else in hexadecimal; at most MAX_SHOWN of them."""
    if data and all(0x20 <= byte < 0x7F for byte in data.rstrip(b"\0")) and data.rstrip(b"\0"):
        text = repr(data[:MAX_SHOWN].rstrip(b"\0").decode("ascii"))
    else:
        text = data[:MAX_SHOWN].hex(" ") or "nothing"
    return text if len(data) <= MAX_SHOWN else f"{text} ... ({len(data)} bytes)"
