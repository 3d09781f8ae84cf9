"""The keys of a machine file: KEYS has those of each table, with the values that each takes. The reader, the writer and the test
of docs/machine.md go by it.

Each field of a settings class (AxisSettings, ChainSettings, Watchdog) is a key of the same name. Its values follow from the type
of the field: a time in ns is a text in the file ("500ms"), an enum its value, a DriveBit a table:
`{ object = "60FD", bit = 31, value = 1 }`. A field that may be None may be left out. The class checks the ranges.
"""

from __future__ import annotations

import re
from dataclasses import Field, fields
from enum import Enum
from typing import Any, Final, TypeVar

from canopen_data import toml_file as toml
from canopen_data.durations import duration_text, parse_duration
from canopen_master.machine_file.model import LossReaction, NetworkSettings, StartOrder
from canopen_master.motion.chain import ChainSettings
from canopen_master.simulation.plant import DEVICE_KEYS, FILE, NODE_ID
from canopen_proto.drives.axis.settings import MODE_CHANGE_STATES, AxisSettings, HomingStyle
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.cia402.axes import MAX_AXES
from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import LocalProtocolError
from canopen_proto.manager.linking.model import MAX_EVERY
from canopen_proto.multiplexer import mux, split_mux
from canopen_transports import parse_bitrate
from canopen_transports.locator import bitrate_text

S = TypeVar("S")


def _is_duration(value: Any) -> bool:
    try:
        return isinstance(value, str) and parse_duration(value) >= 0
    except ValueError:
        return False


def _choice(enum: type[Enum]) -> toml.ValueKind:
    return toml.one_of(each.value for each in enum)._replace(convert=enum, write=_value)


def _value(member: Enum) -> Any:
    return member.value


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


def _bit_table(bit: DriveBit) -> dict[str, Any]:
    index, subindex = split_mux(bit.mux)
    return {"object": f"{index:04X}:{subindex:02X}", "bit": bit.bit, "value": bit.value}


def _is_bitrate(value: Any) -> bool:
    try:
        return isinstance(value, str) and parse_bitrate(value) > 0
    except ValueError:
        return False


DURATION: Final = toml.ValueKind('a time such as "500ms" or "2s"', _is_duration, parse_duration, duration_text)
KINDS: Final[toml.Keys] = {
    "bool": toml.BOOLEAN,
    "int": toml.INTEGER,
    "float": toml.NUMBER,
    "str": toml.text("a text"),
    "Time": DURATION,
    "HomingStyle": _choice(HomingStyle),
    "Unit": _choice(Unit),
    "State": toml.one_of(each.value for each in MODE_CHANGE_STATES)._replace(convert=State, write=_value),
    "StartOrder": _choice(StartOrder),
    "LossReaction": _choice(LossReaction),
    "DriveBit": toml.ValueKind('{ object = "60FD", bit = 31 } or the like', _is_bit, _bit, _bit_table),
}
"""By the annotation of a field, without "| None"."""


def kind_of(each: Field[Any]) -> toml.ValueKind:
    """Return the kind of a field of a settings class."""
    return KINDS[str(each.type).removesuffix(" | None")]


def keys_of(settings: type[Any], *others: str) -> dict[str, toml.ValueKind]:
    """Return the keys of a settings class, without `others`."""
    return {each.name: kind_of(each) for each in fields(settings) if each.name not in others}


def take_settings(table: toml.TomlTable, settings: type[S], **known: Any) -> S | None:
    """Make settings of the keys of a table; None if they contradict each other, which adds an error. known: fields that are not
    keys."""
    names = [each.name for each in fields(settings) if each.name not in known]  # type: ignore[arg-type]
    try:
        return settings(**known, **table.take_all(names))
    except LocalProtocolError as error:
        table.error_naming(str(error))
        return None


def settings_table(settings: Any, *others: str) -> dict[str, Any]:
    """Return the keys of settings, without `others` and without those that have the default."""
    return toml.table_of(keys_of(type(settings), *others), settings, type(settings)())


MODES: Final[dict[str, Mode | None]] = {
    "auto": None,
    "ip": Mode.INTERPOLATED_POSITION,
    "csp": Mode.CYCLIC_SYNCHRONOUS_POSITION,
    "pp": Mode.PROFILE_POSITION,
}
"""The modes of a chain."""
PER_TURN: Final = "counts_per_turn"
_CYCLE: Final = DURATION._replace(
    expected='a time above 0, such as "10ms"', fits=lambda value: DURATION.fits(value) and DURATION.convert(value) > 0
)
_JOINTS: Final = toml.texts("a list of joints")._replace(
    fits=lambda value: isinstance(value, list) and bool(value) and all(isinstance(each, str) for each in value)
)
_ENDS: Final = toml.texts('"NODE OBJECT", "master", or a list of such texts')
KEYS: Final[dict[str, toml.Keys]] = {
    "master": {
        "cycle": _CYCLE,
        "timeout": _CYCLE,
        "heartbeat_timeout": DURATION,
        "watchdog": toml.FALSE_OR_TABLE._replace(write=lambda watchdog: watchdog is not None and settings_table(watchdog)),
        "realtime": toml.FALSE_OR_TABLE._replace(write=settings_table),
    },
    "network": keys_of(NetworkSettings),
    "simulation": {"state": FILE},
    "buses": {
        "locator": toml.text("a locator"),
        "bitrate": toml.ValueKind('a bit rate such as "500k" or "1M"', _is_bitrate, parse_bitrate, bitrate_text),
    },
    "nodes": {
        "bus": toml.text("the name of a bus"),
        **DEVICE_KEYS,
        "id": NODE_ID._replace(convert=lambda value: (value,), write=lambda node_ids: node_ids[0]),
        "boot": toml.FALSE_OR_TABLE,
    },
    "joints": {
        "node": toml.text("the name of a node"),
        "axis": toml.whole("an axis", 0, MAX_AXES - 1),
        PER_TURN: toml.ValueKind("a number above 0", lambda value: type(value) in (int, float) and 0 < value < 1e300, float),
        **keys_of(AxisSettings),
    },
    "chains": {
        "joints": _JOINTS,
        **keys_of(ChainSettings, "cycle_time", "mode"),
        "mode": toml.one_of(MODES),
    },
    "links": {
        "from": _ENDS,
        "to": _ENDS,
        "every": toml.whole("a number", 1, MAX_EVERY)._replace(expected=f"a number of SYNCs, 1..{MAX_EVERY}"),
        "event_driven": toml.BOOLEAN,
        **dict.fromkeys(("inhibit_time", "event_timer", "timeout"), DURATION),
    },
}
"""The keys of each table of the file."""
