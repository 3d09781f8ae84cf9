"""`canopen plan`: find out whether a network fits on its bus before it is built. No bus is opened."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from canopen_cli.shared.device_files import description_of, read_device_files
from canopen_cli.shared.named_machine import machine_argument, machine_of
from canopen_cli.shared.options import Duration, Settings, command
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_data import load_dictionary
from canopen_data.description import DeviceDescription
from canopen_master.bus_timing import BusTiming, Exchange, OtherTraffic, StreamTiming, bus_timing, milliseconds
from canopen_master.exchanges import (
    Counted,
    exchange_of_file,
    exchange_of_named,
    exchange_of_plans,
    exchange_with_links,
    room_for,
)
from canopen_master.machine_file import BusEntry, ChainEntry, JointEntry, MachineFile
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.machine_file.links import configured_dictionaries, linked_buses, plan_bus
from canopen_master.motion.chain import ChainSettings
from canopen_master.motion.chain_file import read_chains
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives.axis.motion_plan import NoMotionPlanError, plan_motion
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, Time
from canopen_transports import parse_bitrate
from canopen_transports.locator import bitrate_text, parse_locator
from canopen_transports.wire import QueueOrder

DEFAULTS = ChainSettings()
COLUMNS = ("what", "CAN-ID", "bytes", "each", "worst", "simulated", "margin")
GROUPED = ("heartbeat", "EMCY")
"""Streams that share one line for all devices: the worst of them is shown."""


@command()
@machine_argument
@click.option("--chains", metavar="FILE", help="A chain file, as `canopen demo --chains` has it.")
@click.option("--cycle", metavar="TIME", type=Duration(100 * MICROSECOND), help="Between two SYNCs: 4ms.")
@click.option("--bitrate", metavar="RATE", help="1M, 500k, 125k ...")
@click.option(
    "--rpdo", metavar="PDO", default=DEFAULTS.rpdo, show_default=True, help="The PDO of PDOs.csv that goes to each joint."
)
@click.option(
    "--tpdo", metavar="PDO", default=DEFAULTS.tpdo, show_default=True, help="The PDO of PDOs.csv that comes from each joint."
)
@click.option("--heartbeat", metavar="TIME", type=Duration(0), default="500ms", show_default=True, help="Of each joint; 0: none.")
@click.option("--sdo", metavar="TIME", type=Duration(0), default="10ms", show_default=True, help="Between two requests; 0: none.")
@click.option("--emcy", metavar="TIME", type=Duration(0), default="100ms", show_default=True, help="Inhibit time; 0: no EMCY.")
@click.option("--errors", metavar="TIME", type=Duration(0), default="0", help="At least between two errors on the bus; 0: none.")
@click.option("--reaction", metavar="TIME", type=Duration(0), default="100us", show_default=True, help="Of a joint, to a SYNC.")
@click.option("--sync-counter", is_flag=True, help="SYNC has the counter of 0x1019: one byte.")
@click.option(
    "--queue",
    type=click.Choice([each.value for each in QueueOrder]),
    default=QueueOrder.PRIORITY.value,
    show_default=True,
    help="Controllers send their most urgent frame first, or the oldest (SocketCAN, most USB adapters; a coarser bound).",
)
def plan(
    settings: Settings,
    screen: Screen,
    file: Path | None,
    chains: str | None,
    cycle: Time | None,
    bitrate: str | None,
    rpdo: str,
    tpdo: str,
    heartbeat: Time,
    sdo: Time,
    emcy: Time,
    errors: Time,
    reaction: Time,
    sync_counter: bool,
    queue: str,
) -> int:
    """Does this network fit? Load, worst latency of each PDO, margins, the shortest cycle that fits.

    No bus is opened. "worst" is the bound of the worst-case analysis for CAN, "simulated" the worst on a simulated bus. "margin"
    is the time left before the next SYNC (PDOs), of 100 ms (each frame of an SDO), or before the same frame comes again. PDOs are
    those of --rpdo and --tpdo, or with -e FILE those that are valid in the device's own file: RPDOs once a cycle, synchronous
    TPDOs at each SYNC, the others once per inhibit time or event timer.

    With a machine file the devices are all of its nodes, and cycle and bit rates are those of the file unless options say
    otherwise. PDOs are as the `configuration` of a node sets them. Joints of a chain with `own_pdos` have the PDOs that the chain
    would plan: see `canopen drive plan NODE`. The links of the file have those of `canopen net links`.

    Exit status: 0 it fits, 1 it does not.

    \b
    canopen plan cell.toml
    canopen plan --chains arm.csv --cycle 4ms --bitrate 1M
    canopen plan --chains arm.csv --cycle 10ms --bitrate 125k --json
    """
    try:
        rate = None if bitrate is None else parse_bitrate(bitrate)
    except ValueError as error:
        raise usage("CO001", str(error), tries=("--bitrate 500k",)) from error
    if file is not None and chains is not None:
        raise usage("CO123", "a machine file or a chain file: one of the two", tries=(f"canopen plan {file}",))
    if file is not None and file.suffix.lower() == ".csv":
        raise usage("CO123", f"{file} is no machine file", tries=(f"--chains {file}    (if it is a chain file)",))
    machine = machine_of(settings, file) if chains is None else None
    if machine is not None:
        cycle = machine.master.cycle if cycle is None else cycle
        rates = {name: rate or _rate_of(bus) for name, bus in machine.buses.items()}
        by_bus = _of_machine(machine, cycle, rates, screen)
    elif chains is not None:
        by_bus = _of_chains(chains, (rpdo, tpdo), settings, screen)
    else:
        raise usage("CO001", "which network?", tries=("--chains arm.csv --cycle 4ms --bitrate 1M", "canopen plan cell.toml"))
    if cycle is None:
        raise usage("CO001", "which cycle?", tries=("--cycle 10ms",))
    background = OtherTraffic(heartbeat, sdo, emcy, reaction, QueueOrder(queue), sync_counter, errors or NEVER)
    plans = []
    for bus, exchanges in by_bus.items():
        known = rate or (None if machine is None else _rate_of(machine.buses[bus]))
        if known is None:
            tries = ("--bitrate 500k", *([] if machine is None else [f'bitrate = "500k" in [buses.{bus}]']))
            raise usage("CO001", f"which bit rate has {bus}?", tries=tries)
        plans.append(bus_timing(bus, exchanges, cycle, known, background))
    if settings.json:
        screen.json([_as_json(each) for each in plans])
    else:
        for each in plans:
            _show(screen, each)
    return ExitCode.OK if all(each.fits for each in plans) else ExitCode.DIFFERENT


def _of_chains(file: str, pdos: tuple[str, str], settings: Settings, screen: Screen) -> dict[str, list[Exchange]]:
    """Return what the joints of a chain file exchange, by bus. pdos: of joints without a file."""
    dictionary, _ = load_dictionary()
    files = read_device_files(settings.eds, dictionary, screen, settings.encoding)
    by_bus: dict[str, list[Exchange]] = {}
    for chain in read_chains(file):
        for joint in chain.joints:
            description = description_of(files, joint.node_id)
            exchange = _exchange(joint.node_id, f"{chain.name}.{joint.name}", dictionary, pdos, description, screen)
            by_bus.setdefault(joint.bus, []).append(exchange)
    planned = {exchange.node_id for joints in by_bus.values() for exchange in joints}
    for node_id in sorted({each for each in files if each is not None} - planned):
        screen.say(f"[yellow]no joint of these chains has node-ID {node_id}: its file is left out[/]")
    return by_bus


def _of_machine(machine: MachineFile, cycle: Time, rates: Mapping[str, int | None], screen: Screen) -> dict[str, list[Exchange]]:
    """Return what the nodes of a machine exchange, by bus. A node without a file that is in no chain exchanges nothing.

    On a bus without room for more, joints with plans of their own send only what is needed, as their chain would have it.
    """
    by_bus, notes = _exchanged(machine, cycle, ())
    crowded = [bus for bus, joints in by_bus.items() if (rate := rates[bus]) and not room_for(joints, cycle, rate).fits]
    if crowded:
        by_bus, notes = _exchanged(machine, cycle, crowded)
    for note in notes:
        screen.say(f"[yellow]{escape(note)}[/]")
    return by_bus


def _exchanged(machine: MachineFile, cycle: Time, lean: Collection[str]) -> tuple[dict[str, list[Exchange]], list[str]]:
    """Return what the nodes exchange, by bus, and notes. lean: the buses whose joints send only what is needed."""
    dictionary, _ = load_dictionary()
    dictionaries = Dictionaries(machine, dictionary)
    axes: dict[str, list[tuple[ChainEntry, JointEntry]]] = {}
    for chain in machine.chains.values():
        for name in chain.joints:
            axes.setdefault(machine.joints[name].node, []).append((chain, machine.joints[name]))
    by_bus: dict[str, list[Exchange]] = {}
    links = {bus: plan_bus(machine, bus, dictionaries) for bus in linked_buses(machine)}
    configured = {bus: configured_dictionaries(machine, bus, dictionaries) for bus in machine.buses}
    notes = []
    for node in machine.nodes.values():
        joints, description = axes.get(node.name, []), dictionaries.description_of(node)
        name = ", ".join(f"{chain.name}.{joint.name}" for chain, joint in joints) or node.name
        own = [each for each in joints if each[0].settings.own_pdos or each[0].settings.mode is None]
        if own and description is not None:
            found, spare = _of_plans(name, node.node_id, dictionaries.of(node), own, cycle, lean=node.bus in lean)
            if spare:
                notes.append(f"{name}: {', '.join(spare)} would be switched off, as the bus has no room")
        elif joints:
            settings = joints[0][0].settings
            found = exchange_of_named(name, node.node_id, dictionary.pdo(settings.rpdo), dictionary.pdo(settings.tpdo))
        elif description is not None:
            found = exchange_of_file(name, node.node_id, configured[node.bus][node.name])
        else:
            notes.append(f"{name} has no file, and is in no chain: it is left out")
            continue
        if node.bus in links and description is not None:
            found = exchange_with_links(found, node.name, links[node.bus])
        notes += [f"{name}: {each}: it is left out" for each in found.left_out]
        by_bus.setdefault(node.bus, []).append(found.exchange)
    return by_bus, notes


def _of_plans(
    name: str,
    node_id: int,
    dictionary: ObjectDictionary,
    axes: Sequence[tuple[ChainEntry, JointEntry]],
    cycle: Time,
    *,
    lean: bool,
) -> tuple[Counted, list[str]]:
    """Return what a node exchanges by the plans of its axes, and the TPDOs that they switch off. If no mode fits,
    these are the PDOs of its file, and its chain says so."""
    try:
        plans = [
            plan_motion(dictionary, node_id, cycle, wish=chain.settings.mode, axis=joint.axis, lean=lean) for chain, joint in axes
        ]
    except NoMotionPlanError:
        return exchange_of_file(name, node_id, dictionary), []
    return exchange_of_plans(name, plans), [f"TPDO {pdo.number}" for plan in plans for pdo in plan.spare]


def _rate_of(bus: BusEntry) -> int | None:
    return bus.bitrate or parse_locator(bus.locator).bitrate


def _exchange(
    node_id: int,
    name: str,
    dictionary: ObjectDictionary,
    pdos: tuple[str, str],
    description: DeviceDescription | None,
    screen: Screen,
) -> Exchange:
    if description is None:
        return exchange_of_named(name, node_id, dictionary.pdo(pdos[0]), dictionary.pdo(pdos[1])).exchange
    return _told(exchange_of_file(name, node_id, description.dictionary), screen)


def _told(found: Counted, screen: Screen) -> Exchange:
    for each in found.left_out:
        screen.say(f"[yellow]{escape(found.exchange.name)}: {each}: it is left out[/]")
    return found.exchange


def _show(screen: Screen, network: BusTiming) -> None:
    nodes = len({each.stream.node_id for each in network.streams} - {0})
    screen.data(
        f"[bold]{escape(network.bus)}[/]: {counted(nodes, 'node')}, {bitrate_text(network.bitrate)}bit/s,"
        f" cycle {milliseconds(network.cycle)}"
    )
    rows = []
    for row in _rows(network.streams):
        worst, stream = row[0], row[0].stream
        name = stream.name if len(row) == 1 else f"{stream.kind}, worst of {len(row)}"
        seen = [each.simulated for each in row if each.simulated is not None]
        margin = "[red]none[/]" if not worst.fits else milliseconds(worst.margin)
        rows.append(
            (
                escape(name),
                f"{stream.can_id:03X}",
                str(stream.size),
                milliseconds(stream.period),
                milliseconds(worst.worst),
                milliseconds(max(seen)) if seen else "not seen",
                margin,
            )
        )
    screen.table(COLUMNS, rows, right=COLUMNS[1:])
    screen.fact("load", f"{network.load:.0%} at worst; simulated {network.simulated_load:.0%}")
    late = [each.stream.name for each in network.streams if not each.fits]
    if late:
        screen.fact("verdict", f"does NOT fit: {', '.join(late[:4])}{' ...' if len(late) > 4 else ''} may come too late")
    else:
        tightest = min((each for each in network.streams if each.stream.period == network.cycle), key=lambda each: each.margin)
        screen.fact("verdict", f"fits: {tightest.stream.name} is there {milliseconds(tightest.margin)} in time at worst")
    shortest = network.shortest_cycle
    screen.fact("shortest cycle", milliseconds(shortest) if shortest is not None else f"none fits: {_remedy(network)}")


def _remedy(network: BusTiming) -> str:
    """Return what would help where no cycle does. A frame that comes more often than the cycle does not wait for a longer one."""
    often = [each.stream.name for each in network.streams if not each.fits and each.stream.period < network.cycle]
    if often:
        return f"a longer inhibit time for {', '.join(often[:4])}{' ...' if len(often) > 4 else ''}, or a faster bus"
    return "fewer nodes or PDOs, or a faster bus"


def _rows(streams: Sequence[StreamTiming]) -> list[list[StreamTiming]]:
    """Return the streams of each line. If there are several, the first is the worst."""
    rows = [[each] for each in sorted(streams, key=lambda each: each.stream.can_id) if each.stream.kind not in GROUPED]
    for kind in GROUPED:
        group = sorted((each for each in streams if each.stream.kind == kind), key=lambda each: each.margin)
        if group:
            rows.append(group)
    return rows


def _as_json(network: BusTiming) -> dict[str, Any]:
    return {
        "bus": network.bus,
        "bitrate": network.bitrate,
        "cycle_ms": network.cycle / MILLISECOND,
        "fits": network.fits,
        "load": round(network.load, 4),
        "simulated_load": round(network.simulated_load, 4),
        "shortest_cycle_ms": None if network.shortest_cycle is None else network.shortest_cycle / MILLISECOND,
        "streams": [
            {
                "kind": each.stream.kind,
                "name": each.stream.name,
                "node": each.stream.node_id or None,
                "can_id": each.stream.can_id,
                "bytes": each.stream.size,
                "period_ms": each.stream.period / MILLISECOND,
                "deadline_ms": each.stream.deadline / MILLISECOND,
                "worst_ms": each.worst / MILLISECOND if each.worst < NEVER else None,
                "simulated_ms": None if each.simulated is None else each.simulated / MILLISECOND,
                "fits": each.fits,
            }
            for each in network.streams
        ],
    }
