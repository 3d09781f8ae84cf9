"""Write machine files. Defaults are left out; the reader gives the same machine back."""

from __future__ import annotations

import re
from typing import Any, Final

from canopen_data.durations import duration_text
from canopen_master.machine_file.kinds import settings_table
from canopen_master.machine_file.link_entries import LINKS, links_tables
from canopen_master.machine_file.model import BusEntry, ChainEntry, MachineFile, MasterEntry, NodeEntry
from canopen_master.machine_file.reader import MODES, chain_defaults
from canopen_master.simulation.plant import AUTOMATIC
from canopen_proto.drives.axis.grip import DEFAULT_GRIP
from canopen_transports.locator import bitrate_text


def machine_text(machine: MachineFile) -> str:
    """Return the text of a machine file. Raises ModuleNotFoundError without `tomli-w` (the extra `master` has it)."""
    import tomli_w  # only for those that write

    return _NUMBERS.sub(lambda found: f"{found[1]} = 0x{int(found[2]):08X}", tomli_w.dumps(machine_tables(machine)))


_NUMBERS: Final = re.compile(r"^(device_type|vendor|product|revision|serial|software) = (\d+)$", re.MULTILINE)
"""Numbers of a node's identity, which people know in hexadecimal."""


def machine_tables(machine: MachineFile) -> dict[str, Any]:
    """Return the tables of a machine file, as `tomllib` would give them."""
    tables = {
        "master": _master(machine.master),
        "network": settings_table(machine.network),
        "simulation": {"state": machine.state} if machine.state else {},
        "buses": {name: _bus(each) for name, each in machine.buses.items()},
        "nodes": {name: _node(each) for name, each in machine.nodes.items()},
        "joints": {
            name: ({} if each.node == name else {"node": each.node})
            | ({"axis": each.axis} if each.axis else {})
            | settings_table(each.settings)
            for name, each in machine.joints.items()
        },
        "chains": {name: _chain(each, machine) for name, each in machine.chains.items()},
        LINKS: links_tables(machine.links),
    }
    return {name: table for name, table in tables.items() if table}


def _master(master: MasterEntry) -> dict[str, Any]:
    table: dict[str, Any] = {
        key: duration_text(value)
        for key in ("cycle", "timeout", "heartbeat_timeout")
        if (value := getattr(master, key)) != getattr(MasterEntry(), key)
    }
    if master.realtime is not None:
        table["realtime"] = settings_table(master.realtime)
    if master.grip is None:
        return {**table, "grip": False}
    return table if master.grip == DEFAULT_GRIP else {**table, "grip": settings_table(master.grip)}


def _bus(bus: BusEntry) -> dict[str, Any]:
    locator = {} if bus.locator == bus.name else {"locator": bus.locator}
    return locator if bus.bitrate is None else {**locator, "bitrate": bitrate_text(bus.bitrate)}


def _node(node: NodeEntry) -> dict[str, Any]:
    device = node.device
    table = {
        "bus": node.bus,
        "id": node.node_id,
        "file": device.file,
        "encoding": device.encoding,
        "overlay": list(device.overlays),
        "profile": "" if device.profile == AUTOMATIC else device.profile,
        "shape": device.shape,
        "script": device.script,
        "defaults": device.defaults,
        "values": dict(device.values),
    }
    boot = {} if node.boot is None else {"boot": settings_table(node.boot)}
    return {key: value for key, value in table.items() if value} | boot


def _chain(chain: ChainEntry, machine: MachineFile) -> dict[str, Any]:
    settings, defaults = chain.settings, chain_defaults(chain.joints, machine.nodes, machine.joints)
    table = settings_table(settings, "cycle_time", "mode", "own_pdos")
    mode = next(word for word, each in MODES.items() if each == settings.mode)
    given = {"mode": mode, "own_pdos": settings.own_pdos}
    table |= {key: value for (key, value), default in zip(given.items(), defaults, strict=True) if value != default}
    return {"joints": list(chain.joints), **table}
