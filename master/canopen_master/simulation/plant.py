"""Plant files: the simulated devices on a bus, in TOML, for `canopen sim plant.toml`.

    bus = "udp_multicast"           # unless -b names one
    state = "state.json"            # stored parameters outlive the simulation

    [[device]]
    file = "drive.eds"              # EDS, DCF, XDD or XDC, or a device in Python; paths are relative to this file
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

from canopen_data import toml_file as toml
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


def parse_plant(content: str, source: str = "plant.toml") -> PlantFile:
    """Return the plant that a text describes. Raises DictionaryError with every error in it. source: the name for messages."""
    reading = toml.TomlReading(source, "plant")
    plant = toml.TomlTable(reading, "", toml.parse_toml(content, source), _PLANT_KEYS, owner="plant")
    bus, state, entries = (plant.take(key) for key in _PLANT_KEYS)
    if not entries and not reading.findings:
        plant.error("there is none: [[device]] begins one", "device")
    if len(entries or ()) > MAX_DEVICES:
        plant.error(f"there are {len(entries)}; a bus has {MAX_DEVICES} node-IDs", "device")
    devices = []
    for number, entry in enumerate((entries or ())[:MAX_DEVICES], start=1):
        table = toml.TomlTable(reading, f"device {number}", entry, DEVICE_KEYS)
        if "file" not in entry:
            table.error("it has no file")
        devices.append(device_of(table))
    reading.raise_errors()
    return PlantFile(tuple(devices), bus or "", state or "")


def device_of(table: toml.TomlTable) -> DeviceEntry:
    """Return the device that a table describes by DEVICE_KEYS; values that do not fit are errors of it."""
    values = table.take_all(DEVICE_KEYS)
    return DeviceEntry(values.pop("file", ""), **{_FIELDS.get(key, key): value for key, value in values.items()})


def device_table(device: DeviceEntry, keys: toml.Keys) -> dict[str, Any]:
    """Return a device as a file has it. keys: DEVICE_KEYS, with the kind of `id` of that file."""
    return toml.table_of({key: keys[key] for key in _WRITTEN}, device, DeviceEntry(""), _FIELDS)


FILE: Final = toml.text("a file name")
NODE_ID: Final = toml.whole("a node-ID", 1, MAX_NODE_ID)
_NODE_IDS: Final = toml.ValueKind(
    f"{NODE_ID.expected}, or a list of them,",
    lambda value: value != [] and all(map(NODE_ID.fits, toml.listed(value))),
    lambda value: tuple(toml.listed(value)),
)
DEVICE_KEYS: Final[toml.Keys] = {
    "file": FILE,
    "id": _NODE_IDS,
    "profile": toml.one_of(PROFILES),
    "shape": toml.one_of(SHAPES),
    "script": FILE,
    "overlay": toml.texts("a file name, or a list of them,"),
    "defaults": toml.BOOLEAN,
    "values": toml.TABLE,
    "encoding": toml.text("an encoding"),
}
"""The keys of a device, here and in a machine file."""
_WRITTEN: Final = ("id", "file", "encoding", "overlay", "profile", "shape", "script", "defaults", "values")
"""The order in which they are written: how the device is simulated comes last."""
_FIELDS: Final = {"id": "node_ids", "overlay": "overlays"}
_PLANT_KEYS: Final[toml.Keys] = {"bus": toml.text("a bus"), "state": FILE, "device": toml.tables("[[device]]")}
