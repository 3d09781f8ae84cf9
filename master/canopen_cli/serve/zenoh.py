"""`canopen serve zenoh`: the buses of this computer in a fleet."""

from __future__ import annotations

from pathlib import Path

import click

from canopen_cli.fleet.joining import Endpoint, SiteName, zenoh_file
from canopen_cli.serve.served import open_service, serve_door
from canopen_cli.shared.options import Settings, command, lasting
from canopen_cli.shared.permissions import allowing
from canopen_cli.shared.screen import Screen, escape
from canopen_gateway import GatewayService, Permission
from canopen_gateway.fleet import FleetDoor, bind_fleet_door
from canopen_gateway.fleet.joining import DEFAULT_ENDPOINT


@command(name="zenoh")
@click.option("--site", type=SiteName(), required=True, metavar="NAME", help="The name of this computer, or its machine: hall-2.")
@click.option(
    "--listen", type=Endpoint(), multiple=True, metavar="ENDPOINT", help=f"Where to listen.  [default: {DEFAULT_ENDPOINT}]"
)
@click.option(
    "--connect",
    type=Endpoint(),
    multiple=True,
    metavar="ENDPOINT",
    help="A router; may be repeated. Then it only listens with --listen.",
)
@zenoh_file
@allowing
@click.option("--reachable", is_flag=True, help="Other computers may come in, though nobody proves who he is.")
@click.option("--twin", is_flag=True, help="Serve though another bridge has the same site and bus: both halt, no more.")
@lasting()
def serve_zenoh(
    settings: Settings,
    screen: Screen,
    site: str,
    listen: tuple[str, ...],
    connect: tuple[str, ...],
    config: Path | None,
    allow: frozenset[Permission],
    reachable: bool,
    twin: bool,
    seconds: float,
) -> None:
    """Bring the buses of this computer into a fleet, on Zenoh, until Ctrl-C.

    Reading is always allowed, and halting; each kind of change has to be named by --allow. Each bus is asked once who is there
    (0x1000 of each node-ID), since nodes without heartbeat would not be seen else.

    \b
    canopen serve zenoh --site hall-2 -b demo
    canopen fleet ls
    canopen serve zenoh --site hall-3 -m cell.toml --connect tcp/plant:7447 --zenoh hall-3.json5
    """
    endpoints = listen or (() if config is not None or connect else (DEFAULT_ENDPOINT,))

    serve_door(
        settings,
        screen,
        lambda: bind_fleet_door(site, connect=connect, listen=endpoints, config=config, reachable=reachable, twin=twin),
        lambda: open_service(settings, screen, allow),
        lambda door, service: _tell(settings, screen, door, service, endpoints, connect, config),
        seconds,
    )


def _tell(
    settings: Settings,
    screen: Screen,
    door: FleetDoor,
    service: GatewayService,
    listen: tuple[str, ...],
    connect: tuple[str, ...],
    config: Path | None,
) -> None:
    buses = door.names_of(service.nets)
    allowed = sorted(each.value for each in service.guard.allowed)
    if settings.json:
        screen.json({"site": door.site, "buses": list(buses), "listen": list(listen), "connect": list(connect), "allow": allowed})
    where = ", ".join((*listen, *connect)) or str(config)
    screen.say(f"[bold]{escape(door.site)} is in the fleet[/], {service.guard.mode}: {escape(where)}")
    for name, net in buses.items():
        screen.say(f"{escape(f'{door.site}/{name}')} is {escape(net)}")
