"""`canopen scan`: find the nodes of a bus. It listens first, then asks a few at a time, and shows each node when it is found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import click
import trio
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from canopen_cli.shared.options import DEMO, NodeIds, Settings, command, lasting
from canopen_cli.shared.over_text import is_text_gateway, refuse_over_text
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape, node_text
from canopen_cli.shared.session import open_session
from canopen_cli.shared.text_gateway import open_text
from canopen_cli.shared.values import identity_json
from canopen_gateway.ascii import RemoteGateway
from canopen_gateway.errors import GatewayRefusedError
from canopen_master.device_types import device_type_text
from canopen_proto import indices
from canopen_proto.datatypes import DataType, text_for_people
from canopen_proto.frame import ALL_NODE_IDS
from canopen_proto.machine import SECOND, Time
from canopen_proto.manager.scan import LISTEN, MAX_NAME, PROBE_TIMEOUT, NodeFound, Scanner, duration_of
from canopen_proto.manager.scan import scan as scan_procedure
from canopen_proto.network import Network
from canopen_transports.loop.beside import beside

COLUMNS: Final = (
    "node", "in the file", "NMT state", "device", "name", "vendor-ID", "product code", "revision", "serial number", "remark",
)  # fmt: skip
DETAILS: Final = ("revision", "serial number")
"""Columns shown only with -v and in JSON, so that a row fits into a terminal."""


@command()
@click.option("--passive", is_flag=True, help="Only listen: nothing is sent.")
@click.option("--ids", "node_ids", type=NodeIds(), help="Whom to ask: 1-32,40. All by default.")
@lasting("How long to listen before asking.  [default: 1.5s]", high=3600, default=LISTEN / SECOND)
def scan(settings: Settings, screen: Screen, passive: bool, node_ids: tuple[int, ...] | None, seconds: float) -> int:
    """Find the nodes of a bus. Exit status 5: none was found.

    Listens for heartbeats and boot-ups, then reads device type and identity of each node-ID, a few at a time. With a machine file
    it shows the names there, and which of its nodes were not found.

    \b
    canopen scan -b demo
    canopen scan --ids 1-32 -b socketcan:can0
    """
    refuse_over_text(settings, passive=passive)
    asked = () if passive else node_ids or tuple(ALL_NODE_IDS)
    found, remark = run(settings, screen, lambda: find_nodes(settings, screen, asked, round(seconds * SECOND)), over_text=True)
    if asked and node_ids is not None:
        others = [str(node.node_id) for node in found if node.node_id not in asked]
        found = [node for node in found if node.node_id in asked]
        remark += f"; heard too, and not asked: {', '.join(others)}" if others else ""
    machine, bus = settings.machine_on_bus()
    names = {} if machine is None else {each.node_id: each.name for each in machine.nodes.values() if each.bus == bus}
    if settings.json:
        known = {} if machine is None else {node.node_id: {"machine": names.get(node.node_id)} for node in found}
        screen.json([{**_as_json(node), **known.get(node.node_id, {})} for node in found])
    elif found:
        cells = [dict(zip(COLUMNS, _row(node, names.get(node.node_id, "")), strict=True)) for node in found]
        hidden = () if settings.verbosity > 0 else DETAILS
        columns = [name for name in COLUMNS if name not in hidden and any(row[name] for row in cells)]
        screen.table(columns, [[row[name] for name in columns] for row in cells], right=("node",))
    how = "heard" if passive else "found"
    screen.say(f"{counted(len(found), 'node')} {how}" + remark)
    missing = names.keys() & set(asked or names) - {node.node_id for node in found}
    if machine is not None and missing:
        listed = ", ".join(f"{escape(names[node_id])} ({node_id})" for node_id in sorted(missing))
        screen.say(f"[yellow]of {escape(machine.source)} not {how}: {listed}[/]")
    return ExitCode.OK if found else ExitCode.NO_ANSWER


def _remark(network: Network, found: Sequence[NodeFound], passive: bool, bus: str) -> str:
    """Tell what else was heard; if nothing was heard, what may be wrong. bus: its locator."""
    rest = set(ALL_NODE_IDS) - {node.node_id for node in found}
    others = [network.heard(node_id) for node_id in sorted(rest)]
    text = "".join(f"; heard, by {each.service.value}: {node_text(each.node_id)}" for each in others if each.service is not None)
    pdos = [node_text(each.node_id) for each in others if each.service is None and each.pdo is not None]
    if pdos:
        text += f"; PDOs were heard that may be those of {', '.join(pdos)}"
    if found or text:
        return text
    if network.last_heard is not None:
        text = ". Frames were heard, but none that shows whose it is"
    elif network.hears_all:
        text = ". Nothing at all was heard"
    if passive:
        return f"{text}. Nodes without a heartbeat are silent: the same without --passive asks them."
    if network.last_heard is not None:
        return f"{text}. Devices that have no node-ID yet are not found: canopen lss scan."
    return f"{text}. {nobody_there(bus)}"


def nobody_there(bus: str) -> str:
    """Return what may be wrong with a bus on which nothing was heard. bus: its locator; one in software has no bit rate."""
    if bus == DEMO or bus.partition(":")[0] in ("virtual", "tcp", "file"):
        asked = "Is anybody there, with power?"
    else:
        asked = "Is anybody there, with power and the same bit rate? One device alone needs a second to acknowledge its frames."
    return f"{asked} Devices that have no node-ID yet are silent, and found by canopen lss scan."


async def find_nodes(settings: Settings, screen: Screen, node_ids: tuple[int, ...], listen: Time) -> tuple[list[NodeFound], str]:
    """Scan the bus of the options, with a bar on a terminal; return the nodes, and what else was heard. node_ids: whom to ask.
    listen: ns, before the first question; not over a text gateway, which hears nothing of them."""
    if is_text_gateway(settings.named_bus()):
        return await _find_over_text(settings, screen, node_ids)
    async with open_session(settings, screen) as session:
        master = session.master
        scanner = Scanner(session.network.out)
        session.network.attach(scanner)
        probe = {} if settings.timeout is None else {"probe_timeout": settings.timeout, "answer_timeout": settings.timeout}
        expected = duration_of(len(node_ids), listen=listen, probe_timeout=probe.get("probe_timeout", 100_000_000))
        async with beside(trio.open_nursery()) as nursery:
            with master.events(NodeFound) as reports:
                nursery.start_soon(_show_progress, screen, expected, reports)
                rows = await master.run(scan_procedure(scanner, node_ids, listen=listen, **probe))
        session.network.detach(scanner)
        for each in rows:
            if session.network.heard(each.node_id).second_answer is not None:
                each.remark = "; ".join(filter(None, (f"two devices answer as node {each.node_id}", each.remark)))
        return rows, _remark(session.network, rows, not node_ids, settings.named_bus() or "")


async def _find_over_text(settings: Settings, screen: Screen, node_ids: Sequence[int]) -> tuple[list[NodeFound], str]:
    """Ask each node-ID for its device type, one after the other, and those that answer for their identity and name."""
    found = []
    async with open_text(settings, screen) as session:
        gateway = session.gateway
        for node_id in node_ids:
            await gateway.set_sdo_timeout(session.sdo_timeout if settings.timeout is not None else PROBE_TIMEOUT / SECOND)
            try:
                device_type = int.from_bytes(await gateway.read(node_id, indices.DEVICE_TYPE), "little")
            except GatewayRefusedError as refused:
                if not refused.is_silence:
                    raise
                continue
            await gateway.set_sdo_timeout(session.sdo_timeout)
            identity = [await _number_over_text(gateway, node_id, each) for each in (1, 2, 3, 4)]
            vendor, product, revision, serial = identity
            try:
                name = (await gateway.read(node_id, indices.MANUFACTURER_DEVICE_NAME))[:MAX_NAME].decode("latin-1")
            except GatewayRefusedError:  # optional
                name = ""
            name = text_for_people(name, DataType.VISIBLE_STRING).rstrip("\0 ")
            found.append(NodeFound(node_id, None, device_type, (vendor, product, revision, serial), name))
    return found, f" by asking, over {escape(settings.required_bus())}"


async def _number_over_text(gateway: RemoteGateway, node_id: int, subindex: int) -> int | None:
    try:
        return int.from_bytes(await gateway.read(node_id, indices.IDENTITY_OBJECT, subindex), "little")
    except GatewayRefusedError:
        return None


async def _show_progress(screen: Screen, expected: Time, reports: Any) -> None:
    """Show a bar on a terminal, with each node when it is found. Elsewhere show nothing: the table comes at the end."""
    if not screen.draws:
        return
    columns = (TextColumn("scanning"), BarColumn(30), TimeRemainingColumn(), TextColumn("{task.fields[nodes]}"))
    with Progress(*columns, console=screen.err, transient=True, auto_refresh=False) as progress:
        task = progress.add_task("scan", total=expected / SECOND, nodes="listening")
        start = trio.current_time()
        nodes: list[str] = []
        while True:
            nodes += [str(report.node_id) for report in reports.take()]
            progress.update(
                task, completed=trio.current_time() - start, nodes=f"found {', '.join(nodes)}" if nodes else "listening"
            )
            progress.refresh()
            await trio.sleep(0.1)


def _row(node: NodeFound, name: str) -> tuple[str, ...]:
    """Return the cells of a node. name: in the machine file."""
    vendor, product, revision, serial = (f"0x{field:08X}" if field is not None else "" for field in node.identity)
    state = node.state.name.lower().replace("_", "-") if node.state is not None else ""
    device = device_type_text(node.device_type) if node.device_type is not None else ""
    who = f"{node.node_id} (0x{node.node_id:02X})"
    return who, escape(name), state, device, escape(node.name), vendor, product, revision, serial, escape(node.remark)


def _as_json(node: NodeFound) -> dict[str, Any]:
    return {
        "node": node.node_id,
        "state": node.state.name if node.state is not None else None,
        "device_type": node.device_type,
        "name": node.name or None,
        **identity_json(node.identity),
        "remark": node.remark or None,
    }
