"""`canopen net links`: the PDOs for the links of a machine file. No bus is opened."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import click

from canopen_cli.machine.group import show_findings
from canopen_cli.shared.named_machine import machine_argument, named_machine
from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_data.findings import DictionaryError
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.machine_file.links import linked_buses, plan_bus
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.concise import pack_concise
from canopen_proto.machine import MILLISECOND
from canopen_proto.manager.linking import MASTER, LinkedPdo, LinkPlan
from canopen_proto.manager.linking.model import LinkTransfer
from canopen_proto.multiplexer import mapping_entry
from canopen_proto.pdo.settings import step_text
from canopen_proto.pdo.slots import shown_entries

COLUMNS: Final = ("CAN-ID", "bytes", "sent", "node", "PDO", "objects")
ENDING: Final = ".cdcf"
EXAMPLE: Final = 'from = "encoder position_value" and to = "lift target_position" below [[links]]'


@command()
@machine_argument
@click.option("--dcf", "folder", metavar="DIR", help=f"Write a concise DCF for each node there: NAME{ENDING}.")
def links(settings: Settings, screen: Screen, file: Path | None, folder: str | None) -> int:
    """Show the PDOs for the links of a machine file: CAN-IDs, mappings, transmission types. No bus is opened.

    They are computed from the files of the devices, and checked against them. `canopen net boot` writes them to the devices; with
    --dcf they are written to files, for another master (0x1F22). `canopen plan` counts them.

    Exit status: 0 all links can be, 1 a link cannot be: each is shown with its line.

    \b
    canopen net links cell.toml
    canopen net links cell.toml --dcf concise
    """
    machine = named_machine(settings, file)
    dictionaries = Dictionaries(machine)
    try:
        plans = {bus: plan_bus(machine, bus, dictionaries) for bus in linked_buses(machine)}
    except DictionaryError as error:
        show_findings(settings, screen, Path(machine.source), error.findings)
        return ExitCode.DIFFERENT
    if not plans:
        raise usage("CO322", f"{machine.source} has no links", tries=(EXAMPLE,))
    if folder is not None:
        _write(settings, screen, plans, Path(folder))
    if settings.json:
        screen.json([_as_json(bus, plan) for bus, plan in plans.items()])
        return ExitCode.OK
    for bus, plan in plans.items():
        _show(screen, bus, plan)
    unlisted = [node for plan in plans.values() for node in plan.changed if machine.nodes[node].boot is None]
    if unlisted:
        screen.say(
            f"[yellow]no boot will write to {escape(', '.join(unlisted))}: boot = {{}} puts a node into the network list[/]"
        )
    if folder is None:
        screen.say("Nothing was written: canopen net boot writes it to the devices, --dcf DIR to files")
    return ExitCode.OK


def _write(settings: Settings, screen: Screen, plans: dict[str, LinkPlan], folder: Path) -> None:
    """Write the concise DCF of each node that has one; nothing is written before all may be."""
    files = {
        str(folder / f"{node}{ENDING}"): pack_concise(plan.writes_of(node)) for plan in plans.values() for node in plan.changed
    }
    for path in files:
        if Path(path).parent != folder:
            raise usage("CO123", f"the name of a node leads out of {folder}: {path}", tries=("another name in the machine file",))
        check_new_file(settings, screen, path)
    for path, data in files.items():
        write_file(path, data)
        screen.say(f"{escape(path)}: {counted(len(data), 'byte')}")


def _show(screen: Screen, bus: str, plan: LinkPlan) -> None:
    screen.data(f"[bold]{escape(bus)}[/]: {counted(len(plan.transfers), 'PDO')} for the links")
    dictionaries = {each.name: each.dictionary for each in plan.members}
    rows = [row for each in plan.transfers for row in _rows(each, dictionaries)]
    screen.table(COLUMNS, rows, right=("bytes",))
    for pdo in plan.destroyed:
        lost = _objects(dictionaries[pdo.node], pdo)
        screen.fact(f"{escape(pdo.node)} {pdo.name}", f"is switched off: it would set the same object as a link ({escape(lost)})")
    for pdo in (pdo for each in plan.members for pdo in plan.pdos_of(each.name) if pdo.lost):
        screen.fact(f"{escape(pdo.node)} {pdo.name}", f"no longer carries {escape(_objects(dictionaries[pdo.node], pdo))}")
    for note in plan.notes:
        screen.fact("note", escape(note))
    for node in plan.changed:
        for place, value in map(step_text, plan.writes_of(node)):
            screen.detail(f"{escape(node)} {place} = {value}")


def _rows(transfer: LinkTransfer, dictionaries: dict[str, ObjectDictionary]) -> list[tuple[str, ...]]:
    """Return the lines of one PDO: its sender, then its receivers."""
    ends = [("from", transfer.sender), *(("to", pdo) for pdo in transfer.receivers)]
    if transfer.to_master:
        ends.append(("to", None))
    rows: list[tuple[str, ...]] = []
    for number, (word, pdo) in enumerate(ends):
        first = (f"0x{transfer.can_id:03X}", str(transfer.size), str(transfer.timing)) if not number else ("", "", "")
        objects = "" if pdo is None else shown_entries(dictionaries[pdo.node], pdo.settings.entries)
        rows.append(
            (*first, f"{word} {escape(MASTER if pdo is None else pdo.node)}", "" if pdo is None else pdo.name, escape(objects))
        )
    return rows


def _objects(dictionary: ObjectDictionary, pdo: LinkedPdo) -> str:
    """Return the objects that a PDO does not carry any longer, for people."""
    return shown_entries(dictionary, [mapping_entry(key, 0) for key in pdo.lost])


def _as_json(bus: str, plan: LinkPlan) -> dict[str, Any]:
    return {
        "bus": bus,
        "pdos": [
            {
                "can_id": each.can_id,
                "bytes": each.size,
                "every": each.timing.every or None,
                "inhibit_time_ms": each.timing.inhibit_time / MILLISECOND,
                "event_timer_ms": each.timing.event_timer / MILLISECOND,
                "timeout_ms": each.timing.timeout / MILLISECOND,
                "links": list(each.links),
                "from": MASTER if each.sender is None else _end_as_json(each.sender),
                "to": [*map(_end_as_json, each.receivers), *([MASTER] if each.to_master else [])],
            }
            for each in plan.transfers
        ],
        "switched_off": [_end_as_json(each) for each in plan.destroyed],
        "notes": list(plan.notes),
        "writes": {
            node: [{"object": place, "value": value} for place, value in map(step_text, plan.writes_of(node))]
            for node in plan.changed
        },
    }


def _end_as_json(pdo: LinkedPdo) -> dict[str, Any]:
    settings = pdo.settings
    return {
        "node": pdo.node,
        "pdo": pdo.name,
        "cob_id": settings.cob_id,
        "transmission_type": settings.transmission_type,
        "entries": list(settings.entries),
        "lost": [f"0x{key >> 8:04X}:{key & 0xFF:02X}" for key in pdo.lost],
    }
