"""Plant files: the simulated devices on a bus, in TOML, for `canopen sim plant.toml`.

    bus = "udp_multicast"           # unless -b names one
    state = "state.json"            # stored parameters outlive the simulation

    [[device]]
    file = "drive.eds"              # EDS, DCF, XDD or XDC; paths are relative to this file
    id = 5                          # or [5, 6, 7]; by default the node-ID of a DCF
    profile = "402"                 # a simulated drive; "none": plain memory; by default the device type decides
    shape = "standard"              # of this drive, or "schunk"
    script = "animate.py"           # see hooks.py
    overlay = "units.toml"          # or several: units, names; see canopen_data/overlay.py
    defaults = true                 # the defaults of the EDS, not the configured values of the DCF

    [device.values]                 # the values of objects at power-on
    1017 = 500
    "identity_object:serial_number" = 4711

All errors of a file are found in one pass, each with its place ("device 2: id: ..."). A text that is no TOML has one error, with
line and column.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from canopen_data.findings import DictionaryError, Finding, Severity
from canopen_data.overlay import parse_toml
from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.frame import MAX_NODE_ID

MAX_DEVICES: Final = MAX_NODE_ID
"""A plant with more devices than node-IDs is wrong."""

AUTOMATIC: Final = "auto"
PROFILES: Final = (AUTOMATIC, "402", "none")
SHAPES: Final = ("standard", "schunk")


@dataclass(frozen=True)
class DeviceEntry:
    """An entry of a plant file: one device, or several with the same file. Paths are as written in the plant file.

    node_ids: empty = that of the device's file. shape: empty = that of the maker's drives. values: by key of the object.
    encoding: of the device's file; empty = detect it.
    """

    file: str
    node_ids: tuple[int, ...] = ()
    profile: str = AUTOMATIC
    shape: str = ""
    script: str = ""
    overlays: tuple[str, ...] = ()
    defaults: bool = False
    values: Mapping[str, Any] = field(default_factory=dict)
    encoding: str = ""


@dataclass(frozen=True)
class Plant:
    """A plant file. bus, state: empty if it names none."""

    devices: tuple[DeviceEntry, ...]
    bus: str = ""
    state: str = ""


class _Reading:
    """Collects the errors of a file while it is read."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.findings: list[Finding] = []

    def error(self, place: str, message: str) -> None:
        self.findings.append(Finding(Severity.ERROR, "plant", f"{place}: {message}", self.source))

    def known(self, place: str, table: Mapping[str, Any], keys: Mapping[str, object] | tuple[str, ...]) -> None:
        for key in table:
            if key not in keys:
                self.error(place, f"there is no entry {key[:40]!r}{did_you_mean(key, keys)}")

    def take(self, place: str, table: Mapping[str, Any], key: str, fits: Callable[[Any], bool], expected: str) -> Any:
        """Return the value of a key; None if it is missing, or if it does not fit, which adds an error."""
        if key not in table:
            return None
        value = table[key]
        if fits(value):
            return value
        self.error(f"{place}: {key}" if place else key, f"{expected} is expected, not {repr(value)[:40]}")
        return None


def parse_plant(text: str, source: str = "plant.toml") -> Plant:
    """Return the plant that a text describes. Raises DictionaryError with every error in it."""
    tables = parse_toml(text, source)
    reading = _Reading(source)
    reading.known("plant", tables, ("bus", "state", "device"))
    bus = reading.take("", tables, "bus", _is_text, "a bus")
    state = reading.take("", tables, "state", _is_text, "a file name")
    entries = reading.take("", tables, "device", _is_list_of_tables, "[[device]]") or []
    if not entries and not reading.findings:
        reading.error("device", "there is none: [[device]] begins one")
    if len(entries) > MAX_DEVICES:
        reading.error("device", f"there are {len(entries)}; a bus has {MAX_DEVICES} node-IDs")
    devices = [_device(reading, f"device {number}", entry) for number, entry in enumerate(entries[:MAX_DEVICES], start=1)]
    if reading.findings:
        raise DictionaryError(reading.findings)
    return Plant(tuple(devices), bus or "", state or "")


_KEYS: Final = ("file", "id", "profile", "shape", "script", "overlay", "defaults", "values")


def _device(reading: _Reading, place: str, table: Mapping[str, Any]) -> DeviceEntry:
    reading.known(place, table, _KEYS)
    if "file" not in table:
        reading.error(place, "it has no file")
    file = reading.take(place, table, "file", _is_text, "a file name")
    ids = reading.take(place, table, "id", _is_node_ids, f"a node-ID of 1..{MAX_NODE_ID}, or a list of them,")
    profile = reading.take(place, table, "profile", PROFILES.__contains__, " or ".join(map(repr, PROFILES)))
    shape = reading.take(place, table, "shape", SHAPES.__contains__, " or ".join(map(repr, SHAPES)))
    script = reading.take(place, table, "script", _is_text, "a file name")
    overlay = reading.take(place, table, "overlay", _is_texts, "a file name, or a list of them,")
    defaults = reading.take(place, table, "defaults", lambda value: isinstance(value, bool), "true or false")
    values = reading.take(place, table, "values", lambda value: isinstance(value, dict), "a table")
    return DeviceEntry(
        file or "",
        tuple(_listed(ids)),
        profile or AUTOMATIC,
        shape or "",
        script or "",
        tuple(_listed(overlay)),
        bool(defaults),
        values or {},
    )


def _listed(value: Any) -> list[Any]:
    if value is None:
        return []
    return value if isinstance(value, list) else [value]


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and bool(value)


def _is_texts(value: Any) -> bool:
    return all(map(_is_text, _listed(value)))


def _is_list_of_tables(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(each, dict) for each in value)


def _is_node_ids(value: Any) -> bool:
    ids = _listed(value)
    return bool(ids) and all(type(each) is int and 1 <= each <= MAX_NODE_ID for each in ids)
