"""`Meaning`: a frame of a bus in words, and the objects in it with their names and values.

Words are made when they are first read: on a full bus most of them never are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

from canopen_proto.datatypes import DataType, Value, ValueRangeError, decode
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.dictionary.standard import find_standard
from canopen_proto.drives.cia402.modes import describe_command
from canopen_proto.drives.cia402.names import names_in_mode
from canopen_proto.drives.cia402.objects import CONTROLWORD, STATUSWORD
from canopen_proto.frame import Frame
from canopen_proto.indices import COMMUNICATION_AREA
from canopen_proto.multiplexer import mux

MAX_SHOWN: Final = 32
"""The most bytes of a value that are shown."""

_NUMBERS: Final = (1, 2, 4, 8)


@dataclass(frozen=True)
class ShownObject:
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


class Words(NamedTuple):
    """A frame in words, and its objects: those of a PDO, in its order, or the one of an SDO transfer."""

    text: str
    objects: tuple[ShownObject, ...] = ()


Say: TypeAlias = Callable[[Frame], Words]
"""Puts a frame in words."""


class Meaning:
    """A frame, understood.

    service: "NMT", "SDO" and the like. node_id: its sender or receiver; 0 for all nodes, or for no node.
    """

    __slots__ = ("_frame", "_say", "_words", "node_id", "service")

    def __init__(self, service: str, node_id: int, say: Say, frame: Frame) -> None:
        self.service = service
        self.node_id = node_id
        self._say = say
        self._frame = frame
        self._words: Words | None = None

    @property
    def text(self) -> str:
        """The frame in words."""
        return self._said().text

    @property
    def objects(self) -> tuple[ShownObject, ...]:
        """The objects of a PDO, in its order, or the one of an SDO transfer."""
        return self._said().objects

    def _said(self) -> Words:
        if self._words is None:
            self._words = self._say(self._frame)
        return self._words

    def __repr__(self) -> str:
        return f"<Meaning {self.service} {self.node_id} {self.text}>"


def variable_at(dictionary: ObjectDictionary, index: int, subindex: int) -> Variable | None:
    """Return an object of a device, or None. A communication object that the dictionary lacks is that of the standard."""
    found = dictionary.get(index, subindex)
    return find_standard(index, subindex) if found is None and index in COMMUNICATION_AREA else found


def shown_of(
    dictionary: ObjectDictionary, node_id: int, index: int, subindex: int, data: bytes | None, *, is_held: bool
) -> ShownObject:
    """Return an object with the value in these bytes; None: without one. data: little-endian. is_held: the device holds this
    value."""
    variable = variable_at(dictionary, index, subindex)
    name = variable.name if variable is not None else ""
    if data is None:
        return ShownObject(node_id, index, subindex, name, None, "", False)
    value: Value = data
    if variable is not None and variable.data_type not in (DataType.DOMAIN, DataType.OCTET_STRING):
        try:
            value = decode(data, variable.data_type)
            text = value_text(dictionary, index, subindex, value)
        except ValueRangeError:
            text = f"{bytes_text(data)} (not of its type, {variable.data_type.name})"
    elif len(data) in _NUMBERS:
        text = f"0x{int.from_bytes(data, 'little'):0{2 * len(data)}X}"
    else:
        text = bytes_text(data)
    return ShownObject(node_id, index, subindex, name, value, text, is_held)


def object_text(dictionary: ObjectDictionary, index: int, subindex: int) -> str:
    """Return an object in words: "6041:00 statusword"."""
    variable = variable_at(dictionary, index, subindex)
    return f"{index:04X}:{subindex:02X}" + (f" {variable.name}" if variable is not None else "")


def value_text(dictionary: ObjectDictionary, index: int, subindex: int, value: Value) -> str:
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


def bytes_text(data: bytes) -> str:
    """Return bytes as text if they are text, else in hexadecimal; at most MAX_SHOWN of them."""
    if data and all(0x20 <= byte < 0x7F for byte in data.rstrip(b"\0")) and data.rstrip(b"\0"):
        text = repr(data[:MAX_SHOWN].rstrip(b"\0").decode("ascii"))
    else:
        text = data[:MAX_SHOWN].hex(" ") or "nothing"
    return text if len(data) <= MAX_SHOWN else f"{text} ... ({len(data)} bytes)"


def hex_text(data: bytes) -> str:
    """Return bytes in hexadecimal, or "no data"."""
    return data.hex(" ") or "no data"
