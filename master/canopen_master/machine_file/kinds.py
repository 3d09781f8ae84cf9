"""The values of settings classes (AxisSettings, ChainSettings, Grip) in TOML: each field is a key of the same name.

A time in ns is a text in the file ("500ms"), an enum its value, a DriveBit a table: `{ object = "60FD", bit = 31, value = 1 }`. A
field that may be None may be left out.
"""

from __future__ import annotations

import re
from dataclasses import Field, fields
from enum import Enum
from typing import Any, Final, TypeVar

from canopen_data.durations import duration_text, parse_duration
from canopen_data.toml_file import BOOLEAN, INTEGER, NUMBER, Kind, TomlTable, one_of, text
from canopen_master.machine_file.booting import LossReaction, StartOrder
from canopen_proto.drives.axis.settings import MODE_CHANGE_STATES, HomingStyle
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import LocalProtocolError
from canopen_proto.multiplexer import mux, split_mux

S = TypeVar("S")


def _is_duration(value: Any) -> bool:
    try:
        return isinstance(value, str) and parse_duration(value) >= 0
    except ValueError:
        return False


def _choice(enum: type[Enum]) -> Kind:
    return one_of(each.value for each in enum)._replace(convert=enum)


_OBJECT: Final = re.compile("([0-9A-Fa-f]{4})(?::([0-9A-Fa-f]{2}))?")


def _is_bit(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and {"object", "bit"} <= value.keys() <= {"object", "bit", "value"}
        and isinstance(value["object"], str)
        and _OBJECT.fullmatch(value["object"]) is not None
        and all(type(value.get(key, 0)) is int for key in ("bit", "value"))
    )


def _bit(value: dict[str, Any]) -> DriveBit:
    found = _OBJECT.fullmatch(value["object"])
    assert found is not None
    return DriveBit(mux(int(found[1], 16), int(found[2] or "0", 16)), value["bit"], value.get("value", 1))


DURATION: Final = Kind('a time such as "500ms" or "2s"', _is_duration, parse_duration)
KINDS: Final[dict[str, Kind]] = {
    "bool": BOOLEAN,
    "int": INTEGER,
    "float": NUMBER,
    "str": text("a text"),
    "Time": DURATION,
    "HomingStyle": _choice(HomingStyle),
    "Unit": _choice(Unit),
    "State": one_of(each.value for each in MODE_CHANGE_STATES)._replace(convert=State),
    "StartOrder": _choice(StartOrder),
    "LossReaction": _choice(LossReaction),
    "DriveBit": Kind('{ object = "60FD", bit = 31 } or the like', _is_bit, _bit),
}
"""By the annotation of a field, without "| None"."""


def kind_of(each: Field[Any]) -> Kind:
    """Return the kind of a field of a settings class."""
    return KINDS[_annotation(each)]


def _annotation(each: Field[Any]) -> str:
    return str(each.type).removesuffix(" | None")


def names_of(settings: type[Any], *others: str) -> list[str]:
    """Return the keys of a settings class, without `others`."""
    return [each.name for each in fields(settings) if each.name not in others]


def take_settings(table: TomlTable, settings: type[S], **known: Any) -> S | None:
    """Make settings of the keys of a table; None if they contradict each other, which adds an error. known: fields that are not
    keys."""
    values = dict(known)
    for each in fields(settings):  # type: ignore[arg-type]
        if each.name not in known and (value := table.take(each.name, kind_of(each))) is not None:
            values[each.name] = value
    try:
        return settings(**values)
    except LocalProtocolError as error:
        table.error(str(error))
        return None


def settings_table(settings: Any, *others: str) -> dict[str, Any]:
    """Return the keys of settings, without `others` and without those that have the default."""
    table = {}
    for each in fields(settings):
        value = getattr(settings, each.name)
        if each.name not in others and value != each.default:
            table[each.name] = value_in_toml(value, _annotation(each))
    return table


def value_in_toml(value: Any, annotation: str = "") -> Any:
    """Return a value as the file has it."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, DriveBit):
        index, subindex = split_mux(value.mux)
        return {"object": f"{index:04X}:{subindex:02X}", "bit": value.bit, "value": value.value}
    return duration_text(value) if annotation == "Time" else value
