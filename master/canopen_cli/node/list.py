"""`canopen node list`: what nodes a machine file names; on request also which of them answer, and which others."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import click

from canopen_cli.bus.scan import find_nodes
from canopen_cli.shared.chosen_machine import ChosenMachine
from canopen_cli.shared.named_machine import machine_argument, named_machine
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_master.machine_file import MachineFile, NodeEntry
from canopen_proto.frame import ALL_NODE_IDS
from canopen_proto.machine import SECOND
from canopen_proto.manager.scan import NodeFound

LISTEN: Final = 3 * SECOND // 2
COLUMNS: Final = ("name", "node", "bus", "joints", "file", "boot", "there")


@command("list")
@machine_argument
@click.option("--look", is_flag=True, help="Look on the buses of the file which nodes are there, and which others.")
def list_nodes(settings: Settings, screen: Screen, file: Path | None, look: bool) -> int:
    """List the nodes of a machine file; with -b or --look also which are there.

    Nothing is sent without -b or --look. With them each bus is scanned as by `canopen scan`: exit status 1 if a node of the file
    does not answer, or another one does.

    \b
    canopen node list cell.toml
    canopen node list cell.toml --look
    canopen node list -m cell.toml -b demo
    """
    machine = named_machine(settings, file)
    buses = _buses(settings, machine, look)
    found = {bus: _there(settings, screen, bus) for bus in buses}
    rows = [(each, _node_there(each, found)) for each in machine.nodes.values() if settings.bus is None or each.bus in buses]
    others = _others(machine, found)
    missing = [each for each, there in rows if each.bus in found and there is None]
    if settings.json:
        screen.json(
            {
                "file": machine.source,
                "nodes": [_as_json(machine, each, there, is_looked_for=each.bus in found) for each, there in rows],
                "others": [{"bus": bus, "node": each.node_id, "name": each.name or None} for bus, each in others],
            }
        )
    else:
        shown = COLUMNS if found else COLUMNS[:-1]
        cells = [_cells(machine, each, there, is_looked_for=each.bus in found)[: len(shown)] for each, there in rows]
        screen.table(shown, cells, right=("node",))
        for bus, each in others:
            name = f" ({escape(each.name)})" if each.name else ""
            screen.data(f"[yellow]not in the file:[/] node {each.node_id}{name} on {escape(bus)}")
        screen.say(counted(len(rows), "node") + (f", {len(missing)} not there" if missing else ""))
    return ExitCode.DIFFERENT if missing or others else ExitCode.OK


def _buses(settings: Settings, machine: MachineFile, look: bool) -> tuple[str, ...]:
    """Return the buses to look on: their names in the machine file."""
    if settings.bus is None:
        return tuple(dict.fromkeys(each.bus for each in machine.nodes.values())) if look else ()
    settings.machine_on_bus()
    return (settings.chosen.bus,)


def _there(settings: Settings, screen: Screen, bus: str) -> list[NodeFound]:
    apart = settings if settings.bus is not None else replace(settings, bus=bus, chosen=ChosenMachine())
    found, _ = run(apart, screen, lambda: find_nodes(apart, screen, tuple(ALL_NODE_IDS), LISTEN))
    return found


def _node_there(node: NodeEntry, found: dict[str, list[NodeFound]]) -> NodeFound | None:
    return next((each for each in found.get(node.bus, ()) if each.node_id == node.node_id), None)


def _others(machine: MachineFile, found: dict[str, list[NodeFound]]) -> list[tuple[str, NodeFound]]:
    named = {(each.bus, each.node_id) for each in machine.nodes.values()}
    return [(bus, each) for bus, nodes in found.items() for each in nodes if (bus, each.node_id) not in named]


def _joints(machine: MachineFile, node: NodeEntry) -> Iterable[str]:
    return [name for name, joint in machine.joints.items() if joint.node == node.name]


def _state(there: NodeFound | None) -> str:
    if there is None:
        return "no"
    return "yes" if there.state is None else f"yes, {there.state.name.lower().replace('_', '-')}"


def _cells(machine: MachineFile, node: NodeEntry, there: NodeFound | None, *, is_looked_for: bool) -> tuple[str, ...]:
    boot = "" if node.boot is None else "mandatory" if node.boot.mandatory else "yes"
    who, joints = f"{node.node_id} (0x{node.node_id:02X})", ", ".join(_joints(machine, node))
    state = _state(there) if is_looked_for else ""
    return escape(node.name), who, escape(node.bus), escape(joints), escape(node.device.file or ""), boot, state


def _as_json(machine: MachineFile, node: NodeEntry, there: NodeFound | None, *, is_looked_for: bool) -> dict[str, Any]:
    return {
        "name": node.name,
        "node": node.node_id,
        "bus": node.bus,
        "joints": list(_joints(machine, node)),
        "file": node.device.file or None,
        "boot": node.boot is not None,
        "there": (there is not None) if is_looked_for else None,
        "state": None if there is None or there.state is None else there.state.name,
    }
