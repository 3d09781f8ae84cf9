"""`canopen serve ascii`: the text gateway of CiA 309-3."""

from __future__ import annotations

from pathlib import Path

import click

from canopen_cli.serve.served import open_service, serve_door
from canopen_cli.shared.options import FILE, Settings, command, lasting
from canopen_cli.shared.permissions import allowing
from canopen_cli.shared.screen import Screen, escape
from canopen_gateway import GatewayService, Permission
from canopen_gateway.ascii import AsciiDoor, bind_ascii_door
from canopen_gateway.ascii.address import DEFAULT_HOST, DEFAULT_PORT
from canopen_proto.gateway import CANOPENNODE, DIALECTS


@command(name="ascii")
@click.option(
    "--bind", default=DEFAULT_HOST, metavar="HOST", show_default=True, help="Where to listen: an address of this computer."
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    help=f"Its TCP port; 0 for any free one.  [default: {DEFAULT_PORT}; none with --unix]",
)
@click.option("--unix", type=FILE, metavar="PATH", help="A Unix socket, for this user alone.")
@allowing
@click.option(
    "--dialect",
    type=click.Choice(list(DIALECTS)),
    default=CANOPENNODE.name,
    show_default=True,
    help="How answers are written: for cocomm, or for what was written for Lely's coctl.",
)
@click.option("--reachable", is_flag=True, help="Other computers may reach it, though it has no password.")
@lasting()
def serve_ascii(
    settings: Settings,
    screen: Screen,
    bind: str,
    port: int | None,
    unix: Path | None,
    allow: frozenset[Permission],
    dialect: str,
    reachable: bool,
    seconds: float,
) -> None:
    """Serve a machine as a text gateway (CiA 309-3), until Ctrl-C.

    Reading is always allowed. Each kind of change has to be named by --allow: `write` for settings, `motion` for what moves a
    drive, `store` for what outlasts the power, `program` for firmware, `nmt`, `lss`. Anybody may halt (`_halt`), always.

    \b
    canopen serve ascii -b demo                     six simulated drives, read-only
    printf '[1] 3 r 0x1008 0 vs\\n' | nc -N localhost 60000
    canopen read 3 1008 -b gw:localhost:60000       as another maker's gateway
    canopen serve ascii -b can0 --allow write,nmt --unix /tmp/CO_command_socket
    """
    at_tcp = (bind, DEFAULT_PORT if port is None else port) if port is not None or unix is None else None
    serve_door(
        settings,
        screen,
        lambda: bind_ascii_door(tcp=at_tcp, unix=unix, dialect=DIALECTS[dialect], reachable=reachable),
        lambda: open_service(settings, screen, allow),
        lambda door, service: _tell(settings, screen, door, service),
        seconds,
    )


def _tell(settings: Settings, screen: Screen, door: AsciiDoor, service: GatewayService) -> None:
    if settings.json:
        allowed = sorted(each.value for each in service.guard.allowed)
        screen.json({"doors": list(door.addresses), "nets": list(service.nets), "allow": allowed})
    for address in door.addresses:
        screen.say(f"[bold]a text gateway (CiA 309-3) at {escape(address)}[/], {service.guard.mode}")
    for number, net in enumerate(service.nets, 1):
        screen.say(f"net {number} is {escape(net)}")
