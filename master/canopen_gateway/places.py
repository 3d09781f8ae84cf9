"""How requests name a net, a node, an axis and an object, in a path or a message, and give a value."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Sequence
from typing import Any, Final

from canopen_gateway.errors import NoSuchPlaceError
from canopen_gateway.service import GatewayService
from canopen_master import Node
from canopen_proto.datatypes import Value, real_of, vanishes
from canopen_proto.dictionary import ObjectDictionary, ObjectNotFoundError
from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.drives.cia402.axes import MAX_AXES

_PLACE: Final = re.compile(r"(?:0[xX])?([0-9A-Fa-f]{4})(?:[:.](?:0[xX])?([0-9A-Fa-f]{1,2}))?")


def find_net(service: GatewayService, text: str) -> str:
    """Return the name of a net. text: that name, or its number, from 1. Raises NoSuchPlaceError."""
    if text in service.nets:
        return text
    if text.isascii() and text.isdecimal() and len(text) < 4 and 1 <= int(text) <= len(service.nets):
        return service.nets[int(text) - 1]
    known = ", ".join(f"{number} ({name})" for number, name in enumerate(service.nets, 1))
    raise NoSuchPlaceError(f"there is no net {text[:40]!r}", seen=f"the nets are {known}")


def find_node(value: Any, *, least: int = 1) -> int:
    """Return a node-ID, 1..127. value: a number, or its text. least: 0 if all nodes may be meant. Raises NoSuchPlaceError."""
    text = str(value)
    if not isinstance(value, bool) and text.isascii() and text.isdecimal() and len(text) < 4 and least <= int(text) <= 127:
        return int(text)
    raise NoSuchPlaceError(f"{text[:40]!r} is no node-ID", seen=f"they are {least} to 127")


def find_axis(text: str) -> int:
    """Return the number of an axis, 0..7. text: that number. Raises ValueError."""
    if text.isascii() and text.isdecimal() and len(text) < 4 and int(text) < MAX_AXES:
        return int(text)
    raise ValueError(f"{text[:40]!r} is no axis; a node has the axes 0 to {MAX_AXES - 1}")


def find_object(dictionary: ObjectDictionary, text: str) -> tuple[int, int]:
    """Return the index and subindex of an object. text: a name, or "6041:00"; a number need not be in the dictionary. Raises
    ObjectNotFoundError for another name."""
    number = number_of_object(text)
    if number is not None:
        return number
    variable = dictionary.variable(text)
    return variable.index, variable.subindex


def check_object(dictionaries: Sequence[ObjectDictionary], text: str) -> None:
    """Raise ObjectNotFoundError for a name that none of these dictionaries has. text: a name, or "6041:00", which may be any."""
    failed: list[ObjectNotFoundError] = []
    for dictionary in dictionaries:
        try:
            find_object(dictionary, text)
        except ObjectNotFoundError as error:
            failed.append(error)
        else:
            return
    if len(failed) == 1:
        raise failed[0]
    names = dict.fromkeys(name for each in dictionaries for variable in each for name in variable.names)
    raise ObjectNotFoundError(f"object {text!r} is in no dictionary at hand{did_you_mean(text, names)}")


def json_said(text: str | bytes) -> Any:
    """Return what a JSON text says. Raises ValueError, in words, if it is none, and for what would be taken for something else in
    silence: a name that stands twice in an object, and a number that becomes 0 or infinity."""
    try:
        return json.loads(text, object_pairs_hook=_once, parse_float=real_of)
    except RecursionError:
        raise ValueError("it is nested too deep") from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        twice = Counter(name for name, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"{twice[:40]!r} stands twice in one object")
    return found


def number_said(value: object) -> float | None:
    """Return a number of a message; None for what is none: another kind of value, NaN, or one too great to reckon with."""
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= 1e300:
        return float(value)
    return None


def number_of_object(text: str) -> tuple[int, int] | None:
    """Return the index and subindex of an object that is named by its number, as "6041:00"; None for a name."""
    number = _PLACE.fullmatch(text)
    return None if number is None else (int(number[1], 16), int(number[2] or "0", 16))


def bytes_of(node: Node, index: int, subindex: int, value: Value | None) -> bytes:
    """Return the bytes of a value. value: a number, a text, a constant by its name; bytes in hexadecimal for an object that holds
    bytes. Raises ValueError, LocalProtocolError: nothing was sent. Also for what JSON has no number for (NaN, Infinity), and for
    what becomes that, as 1e999 does."""
    variable = node.dictionary.at(index, subindex)
    if not isinstance(value, int | float | str) or (isinstance(value, bool) and not isinstance(variable.codec.zero, bool)):
        raise ValueError(f"{variable.label}: the value has to be a number or a text")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{variable.label}: the value has to be a finite number; others can be given as bytes")
    if isinstance(value, str) and isinstance(variable.codec.zero, bytes):
        value = bytes.fromhex(value)
    data = node.remote.encode(variable, value)[2]
    if isinstance(value, float) and vanishes(value, variable.data_type):
        raise ValueError(f"{variable.label}: {value} is too small for {variable.data_type.name}: it would become 0")
    return data
