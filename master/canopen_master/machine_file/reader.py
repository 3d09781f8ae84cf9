"""Read machine files; docs/machine.md has all keys. Nothing is guessed: a key that is not known, or does not fit, is an error.

All errors of a file are found in one pass, each with its line. A text that is no TOML has one error.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeVar

from canopen_data import DataError, expanded, text_of
from canopen_data.descriptions import samples
from canopen_data.toml_file import TABLE, Kind, TomlReading, TomlTable, one_of, parse_toml, places_of, text, texts
from canopen_master.machine_file.booting import BootSettings, NetworkSettings
from canopen_master.machine_file.kinds import DURATION, names_of, take_settings
from canopen_master.machine_file.link_entries import LINKS, take_links
from canopen_master.machine_file.model import BusEntry, ChainEntry, JointEntry, MachineFile, MasterEntry, NodeEntry
from canopen_master.motion.chain import ChainSettings
from canopen_master.simulation.plant import DEVICE_KEYS, FILE, device_of, is_node_id
from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.drives.axis.grip import Grip
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.units import DriveUnits, Unit
from canopen_proto.drives.cia402.axes import MAX_AXES
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.frame import MAX_NODE_ID
from canopen_proto.machine import SECOND
from canopen_transports import TransportError, parse_bitrate
from canopen_transports.locator import bitrate_text, parse_locator
from canopen_transports.realtime import Realtime

E = TypeVar("E")

SECTIONS: Final = ("buses", "nodes", "joints", "chains")
MODES: Final[dict[str, Mode | None]] = {
    "auto": None,
    "ip": Mode.INTERPOLATED_POSITION,
    "csp": Mode.CYCLIC_SYNCHRONOUS_POSITION,
    "pp": Mode.PROFILE_POSITION,
}
"""The modes of a chain."""
_DEFAULTS: Final = SECTIONS[1:]
_DEMO: Final = "demo"
_WITHOUT_RATE: Final = "udp_multicast"
"""The one interface of python-can whose locator needs no bit rate; of ours, none does."""
_NUMBER: Final = re.compile("0[xX].*|[0-9].*")
_PER_TURN: Final = "counts_per_turn"
_NODE_ID: Final = Kind(f"a node-ID of 1..{MAX_NODE_ID}", is_node_id, lambda value: (value,))
_AXIS: Final = Kind(f"an axis of 0..{MAX_AXES - 1}", lambda value: type(value) is int and 0 <= value < MAX_AXES, int)
_FALSE_OR_TABLE: Final = Kind("false, or a table", lambda value: value is False or isinstance(value, dict))
_CYCLE: Final = DURATION._replace(fits=lambda value: DURATION.fits(value) and DURATION.convert(value) > 0)


def read_machine(path: str | Path) -> MachineFile:
    """Return the machine that a file describes.

    Raises DataError if it cannot be read, DictionaryError with every error in it, also for each file that it names and that is
    not there.
    """
    where = expanded(path)
    content = text_of(where, str(where))
    if content is None:
        raise DataError(f"there is no file {str(where)!r}", "check the path", "canopen machine from-chains    makes one")
    return parse_machine(content, str(path), where.parent)


def parse_machine(content: str, source: str = "machine.toml", folder: Path | None = None) -> MachineFile:
    """Return the machine that a text describes. folder: of the files that it names; None: they are not looked for.

    Raises DictionaryError with every error in it.
    """
    return _machine_of(parse_toml(content, source), TomlReading(source, "machine", places_of(content)), folder)


def machine_of_tables(tables: dict[str, Any], source: str, folder: Path | None = None) -> MachineFile:
    """Return the machine that tables describe, with the keys of a machine file, but from elsewhere.

    As `parse_machine` otherwise.
    """
    return _machine_of(tables, TomlReading(source, "machine", {}), folder)


def _machine_of(tables: dict[str, Any], reading: TomlReading, folder: Path | None) -> MachineFile:
    machine = _Reader(reading, tables, folder).machine()
    reading.raise_errors()
    return replace(machine, source=reading.source, folder=folder)


class _Reader:
    """Reads the tables of one file."""

    def __init__(self, reading: TomlReading, tables: dict[str, Any], folder: Path | None) -> None:
        self._reading = reading
        self._folder = folder
        self._top = TomlTable(reading, "", tables)
        self._top.check_keys(("master", "network", "defaults", "simulation", *SECTIONS, LINKS), "the file")

    def machine(self) -> MachineFile:
        buses = self._entries("buses", self._bus)
        self._buses = tuple(self._top.take("buses", TABLE) or ())  # also those with errors
        if not self._buses and "buses" not in self._reading.blamed:
            self._top.error("there is none: [buses.NAME] begins one", "buses")
        nodes = self._entries("nodes", self._node)
        self._nodes = tuple(nodes)
        joints = self._entries("joints", self._joint)
        master = self._master()
        chains = self._entries("chains", lambda table: self._chain(table, master, nodes, joints))
        self._check_unique(buses, nodes, joints, chains)
        simulation = self._table(self._top, "simulation", ("state",))
        network = take_settings(self._table(self._top, "network", tuple(names_of(NetworkSettings))), NetworkSettings)
        links = take_links(self._reading, self._top, nodes, joints)
        state = simulation.take("state", FILE) or ""
        return MachineFile(buses, nodes, joints, chains, master, state, network or NetworkSettings(), links)

    # ---- tables ----

    def _table(self, parent: TomlTable, key: str, keys: tuple[str, ...], fallback: TomlTable | None = None) -> TomlTable:
        """Return a table in another one, empty if there is none, with its keys checked."""
        place = f"{parent.place}.{key}" if parent.place else key
        table = TomlTable(self._reading, place, parent.take(key, TABLE) or {}, (*parent.path, key), fallback)
        table.check_keys(keys)
        return table

    def _entries(self, section: str, make: Callable[[TomlTable], E | None]) -> dict[str, E]:
        """Return the entries of a section by name. One with errors is left out; the errors stay in the reading."""
        keys: tuple[str, ...] = KEYS[section]
        fallback = None
        if section in _DEFAULTS:
            allowed = tuple(key for key in keys if key not in _OF_ONE)
            defaults = TomlTable(self._reading, "defaults", self._top.take("defaults", TABLE) or {}, ("defaults",))
            defaults.check_keys(_DEFAULTS)
            fallback = self._table(defaults, section, allowed)
        whole = TomlTable(self._reading, section, self._top.take(section, TABLE) or {}, (section,))
        found = {}
        for name in whole.values:
            if not name.strip() or any(map(str.isspace, name)) or (_NUMBER.fullmatch(name) and section != "buses"):
                whole.error("a name has no blanks, and does not begin with a digit", name)
                continue
            if whole.take(name, TABLE) is None:
                continue
            entry = make(self._table(whole, name, keys, fallback))
            if entry is not None:
                found[name] = entry
        return found

    # ---- entries ----

    def _master(self) -> MasterEntry:
        table = self._table(self._top, "master", ("cycle", "timeout", "heartbeat_timeout", "grip", "realtime"))
        cycle, timeout = table.take("cycle", _CYCLE), table.take("timeout", _CYCLE)
        heartbeat = table.take("heartbeat_timeout", DURATION)
        given = {"cycle": cycle, "timeout": timeout, "heartbeat_timeout": heartbeat}
        entry = MasterEntry(**{key: value for key, value in given.items() if value is not None})
        if table.take("realtime", _FALSE_OR_TABLE) not in (None, False):
            entry = replace(entry, realtime=take_settings(self._table(table, "realtime", tuple(names_of(Realtime))), Realtime))
        grip = table.take("grip", _FALSE_OR_TABLE)
        if grip is False:
            return replace(entry, grip=None)
        if grip is not None:
            settings = take_settings(self._table(table, "grip", tuple(names_of(Grip))), Grip)
            return entry if settings is None else replace(entry, grip=settings)
        return entry

    def _bus(self, table: TomlTable) -> BusEntry | None:
        name = table.path[-1]
        locator = table.take("locator", text("a locator")) if table.has("locator") else name
        if locator is None:
            return None
        rate = table.take("bitrate", _BITRATE)
        if locator == _DEMO:
            key = "locator" if table.has("locator") else ""
            table.error("'demo' is the simulated arm of the command line (-b demo), not a bus; try locator = 'virtual:demo'", key)
            return None
        try:
            told = parse_locator(locator)
        except TransportError as error:
            table.error(f"{error.failed}: {error.seen}", "locator" if table.has("locator") else "")
            return None
        if rate and told.bitrate and rate != told.bitrate:
            table.error(f"the locator {locator!r} has another bit rate", "bitrate")
        elif rate and not told.bitrate and not told.own and told.interface != _WITHOUT_RATE:
            address, mark, options = locator.partition("?")
            meant = f"{address}@{bitrate_text(rate)}{mark}{options}"
            table.error(f"the locator has to tell it: locator = {meant!r}", "bitrate")
        return BusEntry(name, locator, rate)

    def _node(self, table: TomlTable) -> NodeEntry | None:
        bus = table.take("bus", text("the name of a bus"))
        if bus is None and not table.has("bus"):
            if len(self._buses) == 1:
                bus = self._buses[0]
            elif self._buses:
                table.error(f"which bus is it on? bus = {' or '.join(map(repr, self._buses))}")
        elif bus is not None and bus not in self._buses:
            table.error(f"there is no bus {bus!r}{did_you_mean(bus, self._buses)}", "bus")
        if not table.has("id"):
            table.error("it has no id (node-ID)")
        device = device_of(table, _NODE_ID)
        named = [("file", device.file), ("script", device.script), *(("overlay", name) for name in device.overlays)]
        self._check_files(table, named)
        boot = self._boot(table)
        return NodeEntry(table.path[-1], bus, device, boot) if bus in self._buses and device.node_ids else None

    def _boot(self, node: TomlTable) -> BootSettings | None:
        if node.take("boot", _FALSE_OR_TABLE) in (None, False):
            return None
        keys = tuple(names_of(BootSettings))
        fallback = node.fallback if "boot" in node.values else None
        defaults = self._table(fallback, "boot", keys) if fallback is not None and fallback.take("boot", TABLE) else None
        table = self._table(node, "boot", keys, defaults)
        settings = take_settings(table, BootSettings)
        if settings is not None:
            self._check_files(table, [("configuration", settings.configuration), ("program", settings.program)])
        return settings

    def _check_files(self, table: TomlTable, named: list[tuple[str, str]]) -> None:
        for key, name in named if self._folder is not None else ():
            assert self._folder is not None
            if name and not (self._folder / name).is_file() and not (key == "file" and name in samples()):
                table.error(f"there is no file {str(self._folder / name)!r}", key)

    def _joint(self, table: TomlTable) -> JointEntry | None:
        name = table.path[-1]
        node = table.take("node", text("the name of a node"))
        if node is None and not table.has("node"):
            node = name
        if node is not None and node not in self._nodes:
            known = f"; [nodes.{name}] is missing, or node = ..." if not table.has("node") else did_you_mean(node, self._nodes)
            if f"nodes.{node}" not in self._reading.blamed:
                table.error(f"there is no node {node!r}{known}", "node" if table.has("node") else "")
        axis = table.take("axis", _AXIS) or 0
        settings = take_settings(table, AxisSettings)
        per_turn = table.take(_PER_TURN, _POSITIVE)
        if settings is not None and not table.has("unit") and settings.counts_per_unit is None:
            for key in (each for each in _IN_UNITS if getattr(settings, each) is not None):
                table.error(f"in which unit? unit = {' or '.join(repr(str(each)) for each in Unit)}", key)
        if settings is not None and per_turn is not None:
            if settings.counts_per_unit is not None:
                table.error("counts_per_unit says it already", _PER_TURN)
            elif settings.unit is None or settings.unit is Unit.MILLIMETRE:
                table.error(f"it needs unit = {' or '.join(repr(str(each)) for each in Unit if each != 'millimetre')}", _PER_TURN)
            else:
                settings = replace(settings, counts_per_unit=DriveUnits(per_turn=per_turn).counts_per(settings.unit))
        return JointEntry(name, node or "", settings or AxisSettings(), axis)

    def _chain(
        self, table: TomlTable, master: MasterEntry, nodes: dict[str, NodeEntry], joints: dict[str, JointEntry]
    ) -> ChainEntry:
        if not table.has("joints"):
            table.error("it has no joints")
        names = table.take("joints", _JOINTS) or ()
        for position, name in enumerate(names):
            if name not in joints and f"joints.{name}" not in self._reading.blamed:
                table.error(f"there is no joint {name!r}{did_you_mean(name, joints)}", "joints")
            if name in names[:position]:
                table.error(f"{name!r} is in it twice", "joints")
        mode, own_pdos = chain_defaults(names, nodes, joints)
        word = table.take("mode", one_of(MODES)) or mode
        settings = take_settings(table, ChainSettings, cycle_time=master.cycle / SECOND, mode=MODES[word]) or ChainSettings()
        if not table.has("own_pdos"):
            settings = replace(settings, own_pdos=own_pdos)
        return ChainEntry(table.path[-1], names, settings)

    # ---- between entries ----

    def _check_unique(
        self,
        buses: dict[str, BusEntry],
        nodes: dict[str, NodeEntry],
        joints: dict[str, JointEntry],
        chains: dict[str, ChainEntry],
    ) -> None:
        self._once("buses", "has the locator of", ((each.name, each.locator) for each in buses.values()))
        self._once("nodes", "has bus and id of", ((each.name, (each.bus, each.node_id)) for each in nodes.values()))
        self._once("joints", "has node and axis of", ((each.name, (each.node, each.axis)) for each in joints.values()))
        for name, joint in joints.items():
            if name in nodes and joint.node in nodes and joint.node != name:
                self._reading.error(f"joints.{name}", f"there is a node {name!r} too, which is another drive", ("joints", name))
        owners: dict[str, str] = {}
        for chain in chains.values():
            for name in dict.fromkeys(chain.joints):
                if name in owners:
                    self._reading.error(
                        f"chains.{chain.name}", f"{name!r} is in chain {owners[name]!r} already", ("chains", chain.name, "joints")
                    )
                owners.setdefault(name, chain.name)

    def _once(self, section: str, what: str, entries: Iterator[tuple[str, object]]) -> None:
        """Add an error for each entry whose value another one has."""
        owners: dict[object, str] = {}
        for name, value in entries:
            if value in owners:
                self._reading.error(f"{section}.{name}", f"it {what} {owners[value]!r}", (section, name))
            owners.setdefault(value, name)


def chain_defaults(names: tuple[str, ...], nodes: Mapping[str, NodeEntry], joints: Mapping[str, JointEntry]) -> tuple[str, bool]:
    """Return `mode` and `own_pdos` of a chain that does not say them.

    PDOs are those of the joints' own files, where there are any. If all joints have files, these decide the mode; else it is that
    of the manual's joints.
    """
    owners = [nodes.get(joints[name].node) for name in names if name in joints]
    files = [owner is not None and bool(owner.device.file) for owner in owners]
    return "auto" if files and all(files) else "ip", any(files)


def _is_bitrate(value: Any) -> bool:
    try:
        return isinstance(value, str) and parse_bitrate(value) > 0
    except ValueError:
        return False


_BITRATE: Final = Kind('a bit rate such as "500k" or "1M"', _is_bitrate, parse_bitrate)
_POSITIVE: Final = Kind("a number above 0", lambda value: type(value) in (int, float) and 0 < value < 1e300, float)
_JOINTS: Final = texts("a list of joints")._replace(
    fits=lambda value: isinstance(value, list) and bool(value) and all(isinstance(each, str) for each in value)
)
KEYS: Final[dict[str, tuple[str, ...]]] = {
    "buses": ("locator", "bitrate"),
    "nodes": ("bus", *DEVICE_KEYS, "boot"),
    "joints": ("node", "axis", _PER_TURN, *names_of(AxisSettings)),
    "chains": ("joints", *names_of(ChainSettings, "cycle_time")),
}
_IN_UNITS: Final = (
    "min_position", "max_position", "max_speed", "max_acceleration", "max_jerk", "following_error_limit",
    "homing_speed", "homing_zero_speed", "homing_acceleration", "home_position",
)  # fmt: skip
"""The keys of a joint whose values are in its unit."""
_OF_ONE: Final = ("id", "node", "axis", "joints")
"""Keys that no default can have: they make an entry what it is."""
