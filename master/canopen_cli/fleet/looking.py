"""`canopen fleet ls` and `canopen fleet read`: who is in a fleet, and what its nodes hold."""

from __future__ import annotations

from typing import Any

import click

from canopen_cli.fleet.joining import PlaceOfObject, WayIn, joined, joining
from canopen_cli.shared.options import Settings, command, with_named_object
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_gateway.errors import BridgeRefusedError, FleetError
from canopen_gateway.fleet import FleetPlace, FleetValue
from canopen_master.plain_text import clean


@command()
@joining
def ls(settings: Settings, screen: Screen, way_in: WayIn) -> int:
    """List the buses and nodes of a fleet, as their bridges see them.

    A node is listed while its bridge has heard of it lately. Exit status 3: no bridge is there.

    \b
    canopen fleet ls --connect tcp/192.168.1.20:7447
    """

    async def look() -> list[tuple[FleetPlace, dict[str, Any]]]:
        told = []
        async with joined(way_in) as fleet:
            for bus in fleet.buses:
                try:
                    told.append((bus, await fleet.status(bus)))
                except (FleetError, BridgeRefusedError) as error:
                    told.append((bus, {"outage": error.failed}))
            nodes = fleet.nodes
        for bus, status in told:
            status.pop("run", None)  # tells two bridges apart, and a person nothing
            known = status.get("nodes")
            states = known if isinstance(known, dict) else {}
            there = [str(each.node_id) for each in nodes if each.bus_place == bus]
            status["nodes"] = {node_id: str(states.get(node_id, "")) for node_id in there}
        return told

    told = run(settings, screen, look)
    if settings.json:
        screen.json([{"place": str(bus), **status} for bus, status in told])
        return ExitCode.OK
    rows: list[tuple[str, str, str]] = []
    for bus, status in told:
        given = status.get("allow")
        allowed = ", ".join(map(str, given)) if isinstance(given, list) and given else "read-only"
        outage = str(status.get("outage") or "")
        rows.append((escape(str(bus)), escape(clean(outage)) or "there", escape(clean(allowed))))
        for node_id, state in status["nodes"].items():
            rows.append((escape(f"{bus}/{node_id}"), escape(clean(state.lower().replace("_", "-"))), ""))
    screen.table(("place", "state", "may be changed"), rows)
    screen.say(f"{counted(len(told), 'bus')}, {counted(sum(len(status['nodes']) for _, status in told), 'node')}")
    return ExitCode.OK


@command()
@click.argument("place", type=PlaceOfObject(node=True))
@click.argument("objects", nargs=-1, metavar="OBJECT...")
@joining
def read(settings: Settings, screen: Screen, place: FleetPlace, objects: tuple[str, ...], way_in: WayIn) -> int:
    """Read objects of nodes of a fleet, side by side. Exit status 5: a node did not answer; 11: it refused.

    PLACE is SITE/BUS/NODE; * stands for each. OBJECT is a name of the bridge's dictionary, or 6041:00; it may stand at the node.

    \b
    canopen fleet read '*/*/*' 1008               all nodes of all machines
    canopen fleet read hall-2/arm/5:statusword
    """
    objects = with_named_object(objects, place)

    async def look() -> list[FleetValue]:
        async with joined(way_in) as fleet:
            if place.node_id > 0 and "*" not in place:
                return [await fleet.read(place, each) for each in objects]
            found = [value for each in objects for value in await fleet.read_all(place, each)]
        if not found:
            raise FleetError(f"no node of the fleet is {place}", tries=("canopen fleet ls",))
        return found

    found = sorted(run(settings, screen, look), key=lambda each: each.place)
    if settings.json:
        screen.json([_as_json(each) for each in found])
    else:
        rows = [(escape(str(each.place)), escape(clean(each.name or each.key)), _shown(each)) for each in found]
        screen.table(("place", "object", "value"), rows)
    return ExitCode.NO_ANSWER if any(each.problem for each in found) else ExitCode.OK


def _shown(value: FleetValue) -> str:
    if value.problem:
        return f"[yellow]{escape(clean(value.problem))}[/]"
    text = value.value.hex(" ") if isinstance(value.value, bytes | bytearray) else str(value.value)
    return escape(clean(f"{text} {value.unit}".rstrip()))


def _as_json(value: FleetValue) -> dict[str, Any]:
    shown = value.value.hex() if isinstance(value.value, bytes | bytearray) else value.value
    plain = shown if isinstance(shown, int | float | str) or shown is None else str(shown)
    return {
        "place": str(value.place),
        "object": value.key,
        "name": value.name,
        "value": plain,
        "unit": value.unit,
        "bytes": value.data.hex(),
        "problem": value.problem,
    }
