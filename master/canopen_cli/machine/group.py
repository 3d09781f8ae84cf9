"""`canopen machine`: check machine files, and make them of chain files and of configurations of ROS packages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from canopen_cli.machine.from_ros import import_
from canopen_cli.machine.limits import limits_as_json, show_limits
from canopen_cli.shared.lazy import NamingGroup
from canopen_cli.shared.named_machine import machine_argument
from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_data.findings import DictionaryError, Finding
from canopen_master.machine_file import (
    JointEntry,
    MachineFile,
    NodeEntry,
    machine_of_chains,
    machine_text,
    parse_machine,
    read_machine,
)
from canopen_master.machine_file.boot_entries import network_of
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.machine_file.links import linked_buses, plan_bus
from canopen_master.motion.chain_file import read_chains


@click.group(cls=NamingGroup)
def machine() -> None:
    """The machine file: one file with the buses, devices, joints and chains of a machine."""


machine.add_command(import_)


@command(group=machine)
@machine_argument
def check(settings: Settings, screen: Screen, file: Path | None) -> int:
    """Check a machine file, and the files that it names. Every error is shown, with its line; without errors, what it describes,
    and where the limits of each joint come from.

    Exit status: 0 no error, 1 errors, 6 the file cannot be read.

    \b
    canopen machine check cell.toml
    """
    path = settings.chosen.path(file or settings.machine)
    if path is None:
        raise usage("CO001", "which machine file?", tries=("canopen machine check cell.toml",))
    try:
        found = read_machine(path)
        dictionaries = Dictionaries(found)
        for node in found.nodes.values():
            dictionaries.of(node)
        for bus in found.buses:
            for note in network_of(found, bus, dictionaries).notes:
                screen.detail(escape(note))
        for bus in linked_buses(found):
            plan_bus(found, bus, dictionaries)
    except DictionaryError as error:
        show_findings(settings, screen, path, error.findings)
        return ExitCode.DIFFERENT
    text = path.read_text(encoding="utf-8-sig")
    if settings.json:
        screen.json({"file": str(path), "findings": [], **_as_json(found), "limits": limits_as_json(found, text)})
        return ExitCode.OK
    _show(screen, found)
    show_limits(screen, found, text)
    screen.say("[green]no error[/]")
    return ExitCode.OK


def show_findings(settings: Settings, screen: Screen, path: Path, findings: tuple[Finding, ...]) -> None:
    """Show the errors in a machine file, and in the files that it names, each with its line."""
    from canopen_cli.shared.eds_files import finding_as_json, finding_lines
    from canopen_data.named_files import lines_of

    if settings.json:
        screen.json({"file": str(path), "findings": [finding_as_json(each) for each in findings]})
        return
    lines = lines_of(path.read_text(encoding="utf-8-sig"))
    for finding in findings:
        of_machine = finding.source == str(path)
        for line in finding_lines(finding, lines if of_machine else []):
            screen.data(line)
    screen.say(counted(len(findings), "error"))


def _drives(machine: MachineFile) -> Iterator[tuple[NodeEntry, JointEntry | None]]:
    """Return each node with each joint on it; a node without joints once."""
    for node in machine.nodes.values():
        joints = [each for each in machine.joints.values() if each.node == node.name]
        for joint in sorted(joints, key=lambda each: each.axis) or (None,):
            yield node, joint


def _show(screen: Screen, machine: MachineFile) -> None:
    rows = []
    for node, joint in _drives(machine):
        chain = "" if joint is None else next((each.name for each in machine.chains.values() if joint.name in each.joints), "")
        rows.append(
            (
                escape(node.bus),
                f"{node.node_id} (0x{node.node_id:02X})",
                escape(node.name),
                escape(node.device.file),
                "" if joint is None else escape(joint.name) + (f" (axis {joint.axis})" if joint.axis else ""),
                "" if joint is None or joint.settings.unit is None else joint.settings.unit.value,
                escape(chain),
            )
        )
    screen.table(("bus", "node", "name", "file", "joint", "unit", "chain"), rows, right=("node",))
    for bus in machine.buses.values():
        screen.fact(f"bus {bus.name}", escape(bus.locator))


def _as_json(machine: MachineFile) -> dict[str, Any]:
    return {
        "buses": {bus.name: bus.locator for bus in machine.buses.values()},
        "nodes": {node.name: {"bus": node.bus, "id": node.node_id} for node in machine.nodes.values()},
        "joints": {joint.name: joint.node for joint in machine.joints.values()},
        "chains": {chain.name: list(chain.joints) for chain in machine.chains.values()},
    }


@command("from-chains", group=machine)
@click.argument("chains", metavar="CHAINS.csv")
@click.option("-o", "--output", metavar="FILE.toml", required=True, help="The machine file to write.")
@click.option(
    "--locator",
    "locators",
    metavar="NAME=LOCATOR",
    multiple=True,
    help="The bus that a name of the chain file means; once for each.",
)
def from_chains(settings: Settings, screen: Screen, chains: str, output: str, locators: tuple[str, ...]) -> None:
    """Make a machine file of a chain file of the manual, yours or an installed one. The chain file stays as it is.

    Units, limits and homing are not in a chain file: add them to the new file.

    \b
    canopen machine from-chains arm.csv -o cell.toml
    canopen machine from-chains arm.csv -o cell.toml --locator left=socketcan:can0 --locator right=socketcan:can1
    """
    check_new_file(settings, screen, output, chains)
    given = dict(_locator(text) for text in locators)
    description = read_chains(chains)
    names = {joint.bus for chain in description for joint in chain.joints}
    for name in given.keys() - names:
        raise usage("CO322", f"--locator: {chains} has no bus {name!r}", seen=f"its buses are {', '.join(sorted(names))}")
    text = machine_text(machine_of_chains(description, given))
    try:
        made = parse_machine(text, output)
    except DictionaryError as error:
        first = error.findings[0].message
        tries = (f"--locator {min(names)}=socketcan:can0", "canopen doctor    (the buses of this computer)")
        raise usage("CO001", f"no machine file can be made of {chains}", seen=first, tries=tries) from error
    write_file(output, text.encode(), chains)
    if settings.json:
        screen.json({"file": output, **_as_json(made)})
        return
    screen.say(f"{escape(output)}: {counted(len(made.joints), 'joint')} in {counted(len(made.chains), 'chain')}")
    screen.say(f"next: canopen demo -m {escape(output)}    (simulated)")


def _locator(text: str) -> tuple[str, str]:
    name, equals, locator = text.partition("=")
    if not (name and equals and locator):
        raise usage("CO001", f"--locator {text!r} is not of the form NAME=LOCATOR", tries=("--locator left=socketcan:can0",))
    return name, locator
