"""`canopen net init`: write a machine file of the nodes that a scan finds. Nothing is written to the nodes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import click

from canopen_cli.bus.scan import find_nodes
from canopen_cli.shared.device_files import split_file
from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.options import DEMO, NodeIds, Settings, command
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_cli.shared.session import open_session
from canopen_data import DataError
from canopen_data.description import DeviceDescription
from canopen_data.descriptions import SUFFIXES, load_description
from canopen_data.findings import DictionaryError
from canopen_master.device_types import device_type_text
from canopen_master.identity_facts import (
    DEVICE_TYPE,
    IDENTITY,
    PRODUCT_CODE,
    VENDOR_ID,
    differences,
    identity_in,
    is_identified,
)
from canopen_master.machine_file import BootSettings, BusEntry, MachineFile, NodeEntry, machine_text
from canopen_master.machine_file.from_chains import bus_name
from canopen_master.simulation.plant import DeviceEntry
from canopen_master.simulation.serving import DEMO_LOCATOR
from canopen_proto import indices
from canopen_proto.frame import ALL_NODE_IDS
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.manager.scan import LISTEN, NodeFound
from canopen_proto.procedures.steps import Procedure, SdoTransferError, all_of, upload

COLUMNS: Final = ("node", "name", "device", "vendor-ID", "product code", "file")


HEARTBEAT: Final = 500 * MILLISECOND
"""For a node that can send heartbeats, and sends none."""


class DeviceFile(NamedTuple):
    """A file of a device."""

    path: str
    description: DeviceDescription


@command()
@click.option("-o", "--output", metavar="FILE.toml", required=True, help="The machine file to write.")
@click.option(
    "--files", "folder", metavar="FOLDER", type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Device files (EDS, DCF, XDD, XDC): each node gets the one that `info -e` calls a MATCH. -e FILE names single ones.",
)  # fmt: skip
@click.option("--serials", is_flag=True, help="Expect the serial numbers, too: devices that were swapped are noticed.")
@click.option("--ids", "node_ids", type=NodeIds(), help="Whom to ask: 1-32,40. All by default.")
def init(
    settings: Settings, screen: Screen, output: str, folder: Path | None, serials: bool, node_ids: tuple[int, ...] | None
) -> None:
    """Write a machine file of the nodes that a scan finds.

    Each node is in the network list, and mandatory: edit what is not so. Its identity is that of its file, else the one that it
    shows. Its heartbeat is the one that it sends, else 500 ms, so that `net watch` notices its loss. Nothing is written to the
    nodes.

    \b
    canopen net init -o cell.toml -b can0
    canopen net init -o cell.toml -b can0 --files eds --serials
    """
    bus = settings.required_bus()
    check_new_file(settings, screen, output)
    files = list(_files(screen, folder, settings.eds))
    named = {node_id: path for node_id, path in map(split_file, settings.eds) if node_id is not None}
    settings.eds = ()  # they are for the new file; the scan needs none
    found, remark, periods = run(settings, screen, lambda: _find(settings, screen, node_ids or tuple(ALL_NODE_IDS)))
    found = [node for node in found if node_ids is None or node.node_id in node_ids]
    if not found:
        raise CommandError(ExitCode.NO_ANSWER, "CO201", "no node was found; nothing was written", seen=remark.strip(" .;"))
    locator = DEMO_LOCATOR if bus == DEMO else bus
    name = settings.chosen.bus or bus_name(locator)
    chosen = {node.node_id: named.get(node.node_id) or _file_of(screen, node, files) for node in found}
    nodes = {
        f"node{node.node_id}": _entry(
            node, name, _beside(chosen[node.node_id], output), periods.get(node.node_id), serials=serials
        )
        for node in found
    }
    machine = MachineFile({name: BusEntry(name, locator)}, nodes)
    write_file(output, machine_text(machine).encode())
    _show(settings, screen, found, chosen, periods, output)


async def _find(settings: Settings, screen: Screen, node_ids: tuple[int, ...]) -> tuple[list[NodeFound], str, dict[int, Time]]:
    """Scan the bus; return the nodes, what else was heard, and with which heartbeat each node that can send one will send it."""
    found, remark = await find_nodes(settings, screen, node_ids, LISTEN)
    periods: dict[int, Time] = {}
    if any(node.device_type is not None for node in found):
        async with open_session(settings, screen) as session:

            def look(node_id: int) -> Procedure[None]:
                try:
                    data = yield from upload(session.node(node_id).remote.sdo, indices.PRODUCER_HEARTBEAT_TIME)
                except SdoTransferError:  # it cannot send one, or does not say so
                    return
                periods[node_id] = int.from_bytes(data[:2], "little") * MILLISECOND or HEARTBEAT

            await session.master.run(all_of(*(look(node.node_id) for node in found if node.device_type is not None)))
    return found, remark, periods


def _files(screen: Screen, folder: Path | None, given: Sequence[str]) -> Iterator[DeviceFile]:
    """Read the files of a folder, and those that are given without a node-ID. One of the folder may be no device file."""
    listed = [] if folder is None else sorted(each for each in folder.iterdir() if each.suffix.lower() in SUFFIXES)
    for path in (*map(str, listed), *(path for node_id, path in map(split_file, given) if node_id is None)):
        try:
            yield DeviceFile(path, load_description(path))
        except (DataError, DictionaryError) as error:
            if path in given:
                raise
            screen.say(f"[yellow]{escape(path)} cannot be read: {escape(str(error).splitlines()[0])}[/]")


def _file_of(screen: Screen, node: NodeFound, files: Sequence[DeviceFile]) -> str:
    """Return the file of a node's device: one with its vendor-ID and product code, which `canopen info -e` calls a MATCH.

    A vendor-ID of 0 is none: a file without one is not taken by itself. It is named if nothing in it contradicts the node.
    So are those without a product code, if no other fits.
    """
    numbers = (node.device_type, *node.identity)
    names = (DEVICE_TYPE, *(name for _, name in IDENTITY))
    shown = {name: number for name, number in zip(names, numbers, strict=True) if number is not None}
    fitting, nameless = list[str](), list[str]()
    for each in files:
        known = identity_in(each.description, node.node_id)
        different = differences(known, shown)
        takes = f"Try: -e {node.node_id}={escape(each.path)}, if it is its file"
        if is_identified(known, shown):
            if not different:
                fitting.append(each.path)
            else:
                why = f"ANOTHER DEVICE by {', '.join(map(str, different))}"
                screen.say(f"[yellow]node {node.node_id}: {escape(each.path)} is not taken: {why}. {takes}[/]")
        elif not different and known.get(PRODUCT_CODE) and known[PRODUCT_CODE] == shown.get(PRODUCT_CODE):
            why = "the file gives no vendor-ID" if not known.get(VENDOR_ID) else "the node shows none"
            screen.say(
                f"[yellow]node {node.node_id}: {escape(each.path)} is not taken by its product code alone: {why}. {takes}[/]"
            )
        elif not different and not known.get(PRODUCT_CODE) and known.get(DEVICE_TYPE):
            nameless.append(each.path)
    if len(fitting) > 1:
        listed = ", ".join(map(escape, fitting))
        screen.say(f"[yellow]node {node.node_id}: several files have its identity, so none is taken: {listed}[/]")
        return ""
    if not fitting and nameless:
        listed = ", ".join(map(escape, nameless))
        takes = f"Try: -e {node.node_id}=FILE, if one is its file"
        screen.say(f"[yellow]node {node.node_id}: these have its device type, and no product code to go by: {listed}. {takes}[/]")
    return fitting[0] if fitting else ""


def _beside(path: str, output: str) -> str:
    """Return a path relative to the folder of the machine file; a sample's name stays as it is."""
    return os.path.relpath(path, Path(output).parent) if path and Path(path).exists() else path


def _entry(node: NodeFound, bus: str, file: str, period: Time | None, *, serials: bool) -> NodeEntry:
    vendor, product, _, serial = node.identity
    own: dict[str, Any] = {} if file else {"device_type": node.device_type, "vendor": vendor, "product": product}
    if serials:
        own["serial"] = serial
    boot = BootSettings(mandatory=True, heartbeat=period, **{key: value for key, value in own.items() if value})
    return NodeEntry(f"node{node.node_id}", bus, DeviceEntry(file, (node.node_id,)), boot)


def _show(
    settings: Settings,
    screen: Screen,
    found: Sequence[NodeFound],
    chosen: Mapping[int, str],
    periods: Mapping[int, Time],
    output: str,
) -> None:
    if settings.json:
        nodes = [
            {
                "node": node.node_id,
                "name": f"node{node.node_id}",
                "file": chosen[node.node_id] or None,
                "heartbeat_ms": _ms(periods.get(node.node_id)),
            }
            for node in found
        ]
        screen.json({"file": output, "nodes": nodes})
        return
    rows = []
    for node in found:
        vendor, product, _, _ = node.identity
        device = device_type_text(node.device_type) if node.device_type is not None else "?"
        numbers = ("?" if number is None else f"0x{number:08X}" for number in (vendor, product))
        rows.append((str(node.node_id), f"node{node.node_id}", device, *numbers, escape(chosen[node.node_id])))
    screen.table(COLUMNS, rows, right=("node",))
    for node in found:
        if node.device_type is None:
            screen.say(f"[yellow]node {node.node_id} was only heard: {escape(node.remark)}[/]")
    silent = [str(node.node_id) for node in found if node.device_type is not None and node.node_id not in periods]
    if silent:
        screen.say(
            f"[yellow]no heartbeat for node {', '.join(silent)}: it does not show 0x1017. Its loss is noticed only with "
            "guard_time in the machine file[/]"
        )
    screen.say(f"{escape(output)}: {counted(len(found), 'node')}, all in the network list and mandatory")
    screen.say(f"next: canopen net check {escape(output)}")


def _ms(time: Time | None) -> float | None:
    return None if time is None else time / MILLISECOND
