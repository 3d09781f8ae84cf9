"""Read and write machine files; docs/machine.md has all keys. Nothing is guessed: a key that is not known, or does not fit, is an
error. All errors of a file are found in one pass, each with its line. A text that is no TOML has one error.

What is written leaves out defaults; the reader gives the same machine back.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeVar

from canopen_data import DataError, expanded, text_of
from canopen_data.descriptions import samples
from canopen_data.toml_file import TABLE, TomlReading, TomlTable, parse_toml, places_of, table_of, tables
from canopen_master.machine_file.keys import KEYS, MODES, PER_TURN, keys_of, settings_table, take_settings
from canopen_master.machine_file.link_entries import LINKS, link_table, take_links
from canopen_master.machine_file.model import (
    BootSettings,
    BusEntry,
    ChainEntry,
    JointEntry,
    MachineFile,
    MasterEntry,
    NetworkSettings,
    NodeEntry,
)
from canopen_master.motion.chain import ChainSettings
from canopen_master.simulation.plant import device_of, device_table
from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.units import DriveUnits, Unit
from canopen_proto.drives.axis.watchdog import Watchdog
from canopen_proto.machine import SECOND
from canopen_transports import TransportError
from canopen_transports.locator import bitrate_text, parse_locator
from canopen_transports.realtime import Realtime

E = TypeVar("E")

_DEFAULTS: Final = ("nodes", "joints", "chains")
_TOP: Final = {
    **dict.fromkeys(("master", "network", "defaults", "simulation", "buses", *_DEFAULTS), TABLE),
    LINKS: tables(f"a list of tables: [[{LINKS}]]"),
}
_DEMO: Final = "demo"
_WITHOUT_RATE: Final = "udp_multicast"
"""The one interface of python-can whose locator needs no bit rate; of ours, none does."""
_NUMBER: Final = re.compile("0[xX].*|[0-9].*")


def read_machine(path: str | Path) -> MachineFile:
    """Return the machine that a file describes. path: may begin with `~`.

    Raises DataError if it cannot be read, DictionaryError with every error in it, also for each file that it names and that is
    not there.
    """
    where = expanded(path)
    content = text_of(where, str(where))
    if content is None:
        raise DataError(f"there is no file {str(where)!r}", "check the path", "canopen machine from-chains    makes one")
    return parse_machine(content, str(path), where.parent)


def parse_machine(content: str, source: str = "machine.toml", folder: Path | None = None) -> MachineFile:
    """Return the machine that a text describes. folder: of the files that it names; None: they are not looked for. source: the
    name for messages.

    Raises DictionaryError with every error in it, LocalProtocolError for what is no text.
    """
    return _machine_of(parse_toml(content, source), TomlReading(source, "machine", places_of(content)), folder)


def machine_of_tables(content: dict[str, Any], source: str, folder: Path | None = None) -> MachineFile:
    """Return the machine that tables describe, with the keys of a machine file, but from elsewhere. source: the name for
    messages.

    As `parse_machine` otherwise.
    """
    return _machine_of(content, TomlReading(source, "machine", {}), folder)


def _machine_of(content: dict[str, Any], reading: TomlReading, folder: Path | None) -> MachineFile:
    machine = _MachineReader(reading, content, folder).machine()
    reading.raise_errors()
    return replace(machine, source=reading.source, folder=folder)


class _MachineReader:
    """Reads the tables of one file."""

    def __init__(self, reading: TomlReading, content: dict[str, Any], folder: Path | None) -> None:
        self._reading = reading
        self._folder = folder
        self._top = TomlTable(reading, "", content, _TOP, owner="the file")

    def machine(self) -> MachineFile:
        buses = self._entries("buses", self._bus)
        self._buses = tuple(self._top.take("buses") or ())  # also those with errors
        if not self._buses and "buses" not in self._reading.blamed:
            self._top.error("there is none: [buses.NAME] begins one", "buses")
        nodes = self._entries("nodes", self._node)
        self._nodes = tuple(nodes)
        joints = self._entries("joints", self._joint)
        master = self._master()
        chains = self._entries("chains", lambda table: self._chain(table, master, nodes, joints))
        self._check_unique(buses, nodes, joints, chains)
        network = take_settings(self._top.table("network", KEYS["network"]), NetworkSettings)
        links = take_links(self._reading, self._top, nodes, joints)
        state = self._top.table("simulation", KEYS["simulation"]).take("state") or ""
        return MachineFile(buses, nodes, joints, chains, master, state, network or NetworkSettings(), links)

    # ---- tables ----

    def _entries(self, section: str, make: Callable[[TomlTable], E | None]) -> dict[str, E]:
        """Return the entries of a section by name. One with errors is left out; the errors stay in the reading."""
        keys = KEYS[section]
        fallback = None
        if section in _DEFAULTS:
            defaults = self._top.table("defaults", dict.fromkeys(_DEFAULTS, TABLE))
            fallback = defaults.table(section, {key: kind for key, kind in keys.items() if key not in _OF_ONE})
        whole = self._top.table(section)
        found = {}
        for name in whole.values:
            if not name.strip() or any(map(str.isspace, name)) or (_NUMBER.fullmatch(name) and section != "buses"):
                whole.error("a name has no blanks, and does not begin with a digit", name)
                continue
            if whole.take(name, TABLE) is None:
                continue
            if (entry := make(whole.table(name, keys, fallback))) is not None:
                found[name] = entry
        return found

    # ---- entries ----

    def _master(self) -> MasterEntry:
        table = self._top.table("master", KEYS["master"])
        values = table.take_all(("cycle", "timeout", "heartbeat_timeout"))
        for key, settings in (("watchdog", Watchdog), ("realtime", Realtime)):
            given = table.take(key)
            if given is False:
                values[key] = None
            elif given is not None and (made := take_settings(table.table(key, keys_of(settings)), settings)) is not None:
                values[key] = made
        return MasterEntry(**values)

    def _bus(self, table: TomlTable) -> BusEntry | None:
        name = table.path[-1]
        locator = table.take("locator") if table.has("locator") else name
        if locator is None:
            return None
        rate = table.take("bitrate")
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
        bus = table.take("bus")
        if bus is None and not table.has("bus"):
            if len(self._buses) == 1:
                bus = self._buses[0]
            elif self._buses:
                table.error(f"which bus is it on? bus = {' or '.join(map(repr, self._buses))}")
        elif bus is not None and bus not in self._buses:
            table.error(f"there is no bus {bus!r}{did_you_mean(bus, self._buses)}", "bus")
        if not table.has("id"):
            table.error("it has no id (node-ID)")
        device = device_of(table)
        named = [("file", device.file), ("script", device.script), *(("overlay", name) for name in device.overlays)]
        self._check_files(table, named)
        boot = self._boot(table)
        return NodeEntry(table.path[-1], bus, device, boot) if bus in self._buses and device.node_ids else None

    def _boot(self, node: TomlTable) -> BootSettings | None:
        if node.take("boot") in (None, False):
            return None
        keys = keys_of(BootSettings)
        fallback = node.fallback if "boot" in node.values else None
        defaults = fallback.table("boot", keys) if fallback is not None and fallback.take("boot", TABLE) else None
        table = node.table("boot", keys, defaults)
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
        node = table.take("node")
        if node is None and not table.has("node"):
            node = name
        if node is not None and node not in self._nodes:
            known = f"; [nodes.{name}] is missing, or node = ..." if not table.has("node") else did_you_mean(node, self._nodes)
            if f"nodes.{node}" not in self._reading.blamed:
                table.error(f"there is no node {node!r}{known}", "node" if table.has("node") else "")
        axis = table.take("axis") or 0
        settings = take_settings(table, AxisSettings)
        per_turn = table.take(PER_TURN)
        if settings is not None and not table.has("unit") and settings.counts_per_unit is None:
            for key in (each for each in _IN_UNITS if getattr(settings, each) is not None):
                table.error(f"in which unit? unit = {' or '.join(repr(str(each)) for each in Unit)}", key)
        if settings is not None and per_turn is not None:
            if settings.counts_per_unit is not None:
                table.error("counts_per_unit says it already", PER_TURN)
            elif settings.unit is None or settings.unit is Unit.MILLIMETRE:
                table.error(f"it needs unit = {' or '.join(repr(str(each)) for each in Unit if each != 'millimetre')}", PER_TURN)
            else:
                settings = replace(settings, counts_per_unit=DriveUnits(per_turn=per_turn).counts_per(settings.unit))
        return JointEntry(name, node or "", settings or AxisSettings(), axis)

    def _chain(
        self, table: TomlTable, master: MasterEntry, nodes: dict[str, NodeEntry], joints: dict[str, JointEntry]
    ) -> ChainEntry:
        if not table.has("joints"):
            table.error("it has no joints")
        names = table.take("joints") or ()
        for position, name in enumerate(names):
            if name not in joints and f"joints.{name}" not in self._reading.blamed:
                table.error(f"there is no joint {name!r}{did_you_mean(name, joints)}", "joints")
            if name in names[:position]:
                table.error(f"{name!r} is in it twice", "joints")
        mode, own_pdos = chain_defaults(names, nodes, joints)
        word = table.take("mode") or mode
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


_IN_UNITS: Final = (
    "min_position", "max_position", "max_speed", "max_acceleration", "max_jerk", "following_error_limit",
    "homing_speed", "homing_zero_speed", "homing_acceleration", "home_position",
)  # fmt: skip
"""The keys of a joint whose values are in its unit."""
_OF_ONE: Final = ("id", "node", "axis", "joints")
"""Keys that no default can have: they make an entry what it is."""


# ---- writing ----


def machine_text(machine: MachineFile) -> str:
    """Return the text of a machine file. Raises ModuleNotFoundError without `tomli-w` (the extra `master` has it)."""
    import tomli_w  # only for those that write

    return _NUMBERS.sub(lambda found: f"{found[1]} = 0x{int(found[2]):08X}", tomli_w.dumps(machine_tables(machine)))


_NUMBERS: Final = re.compile(r"^(device_type|vendor|product|revision|serial|software) = (\d+)$", re.MULTILINE)
"""Numbers of a node's identity, which people know in hexadecimal."""


def machine_tables(machine: MachineFile) -> dict[str, Any]:
    """Return the tables of a machine file, as `tomllib` would give them."""
    tables = {
        "master": table_of(KEYS["master"], machine.master, MasterEntry()),
        "network": settings_table(machine.network),
        "simulation": {"state": machine.state} if machine.state else {},
        "buses": {name: table_of(KEYS["buses"], each, BusEntry(name, name)) for name, each in machine.buses.items()},
        "nodes": {name: _node(each) for name, each in machine.nodes.items()},
        "joints": {
            name: ({} if each.node == name else {"node": each.node})
            | ({"axis": each.axis} if each.axis else {})
            | settings_table(each.settings)
            for name, each in machine.joints.items()
        },
        "chains": {name: _chain(each, machine) for name, each in machine.chains.items()},
        LINKS: [link_table(each) for each in machine.links],
    }
    return {name: table for name, table in tables.items() if table}


def _node(node: NodeEntry) -> dict[str, Any]:
    boot = {} if node.boot is None else {"boot": settings_table(node.boot)}
    return {"bus": node.bus} | device_table(node.device, KEYS["nodes"]) | boot


def _chain(chain: ChainEntry, machine: MachineFile) -> dict[str, Any]:
    settings, defaults = chain.settings, chain_defaults(chain.joints, machine.nodes, machine.joints)
    table = settings_table(settings, "cycle_time", "mode", "own_pdos")
    mode = next(word for word, each in MODES.items() if each == settings.mode)
    given = {"mode": mode, "own_pdos": settings.own_pdos}
    table |= {key: value for (key, value), default in zip(given.items(), defaults, strict=True) if value != default}
    return {"joints": list(chain.joints), **table}
