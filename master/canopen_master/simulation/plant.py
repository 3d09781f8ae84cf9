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
    encoding = "gbk"                # of the file; by default a guess

    [device.values]                 # the values of objects at power-on
    1017 = 500
    "identity_object:serial_number" = 4711

All errors of a file are found in one pass, each with its place ("device 2: id: ..."). A text that is no TOML has one error, with
line and column.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from canopen_data import toml_file
from canopen_data.toml_file import BOOLEAN, TABLE, Kind, TomlReading, TomlTable, listed, one_of, parse_toml
from canopen_proto.frame import MAX_NODE_ID

MAX_DEVICES: Final = MAX_NODE_ID
"""A plant with more devices than node-IDs is wrong."""

AUTOMATIC: Final = "auto"
DRIVE: Final = "402"
PROFILES: Final = (AUTOMATIC, DRIVE, "none")
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
class PlantFile:
    """A plant file. bus, state: empty if it names none."""

    devices: tuple[DeviceEntry, ...]
    bus: str = ""
    state: str = ""


def parse_plant(text: str, source: str = "plant.toml") -> PlantFile:
    """Return the plant that a text describes. Raises DictionaryError with every error in it."""
    reading = TomlReading(source, "plant")
    plant = TomlTable(reading, "", parse_toml(text, source))
    plant.check_keys(("bus", "state", "device"), "plant")
    bus = plant.take("bus", toml_file.text("a bus"))
    state = plant.take("state", FILE)
    entries = plant.take("device", _DEVICES) or []
    if not entries and not reading.findings:
        plant.error("there is none: [[device]] begins one", "device")
    if len(entries) > MAX_DEVICES:
        plant.error(f"there are {len(entries)}; a bus has {MAX_DEVICES} node-IDs", "device")
    devices = []
    for number, entry in enumerate(entries[:MAX_DEVICES], start=1):
        table = TomlTable(reading, f"device {number}", entry)
        table.check_keys(DEVICE_KEYS)
        if "file" not in entry:
            table.error("it has no file")
        devices.append(device_of(table))
    reading.raise_errors()
    return PlantFile(tuple(devices), bus or "", state or "")


DEVICE_KEYS: Final = ("file", "id", "encoding", "profile", "shape", "script", "overlay", "defaults", "values")


def device_of(table: TomlTable, ids: Kind | None = None) -> DeviceEntry:
    """Return the device that a table describes by DEVICE_KEYS; values that do not fit are errors of it. ids: the kind of `id`."""
    return DeviceEntry(
        table.take("file", FILE) or "",
        table.take("id", ids or _NODE_IDS) or (),
        table.take("profile", one_of(PROFILES)) or AUTOMATIC,
        table.take("shape", one_of(SHAPES)) or "",
        table.take("script", FILE) or "",
        table.take("overlay", toml_file.texts("a file name, or a list of them,")) or (),
        bool(table.take("defaults", BOOLEAN)),
        table.take("values", TABLE) or {},
        table.take("encoding", toml_file.text("an encoding")) or "",
    )


FILE: Final = toml_file.text("a file name")


def is_node_id(value: Any) -> bool:
    """Return whether a value of a file is a node-ID."""
    return type(value) is int and 1 <= value <= MAX_NODE_ID


_DEVICES: Final = Kind("[[device]]", lambda value: isinstance(value, list) and all(isinstance(each, dict) for each in value))
_NODE_IDS: Final = Kind(
    f"a node-ID of 1..{MAX_NODE_ID}, or a list of them,",
    lambda value: value != [] and all(map(is_node_id, listed(value))),
    lambda value: tuple(listed(value)),
)
