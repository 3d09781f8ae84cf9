"""`canopen serve web`: a page, an HTTP interface and a WebSocket."""

from __future__ import annotations

from canopen_cli.serve.served import open_service, serve_door
from canopen_cli.shared.options import Settings, command, lasting
from canopen_cli.shared.permissions import allowing
from canopen_cli.shared.screen import Screen, escape
from canopen_cli.shared.web_address import BindDoor, web_address
from canopen_gateway import GatewayService, Permission
from canopen_gateway.web import WebDoor


@command(name="web")
@web_address
@allowing
@lasting()
def serve_web(
    settings: Settings,
    screen: Screen,
    bind_door: BindDoor,
    allow: frozenset[Permission],
    seconds: float,
) -> None:
    """Serve a machine as a page in a browser, and by HTTP, until Ctrl-C. Needs the extra `web`.

    Open the address that it prints: the token in it is the key. Reading is always allowed. Each kind of change has to be named by
    --allow, as for `canopen serve ascii`. Anybody who has the token may halt, always.

    \b
    canopen serve web -b demo                       six simulated drives, read-only
    canopen serve web -b can0 --allow write,nmt
    canopen serve web -m cell.toml --allow motion   jog its chains, with a dead man's switch
    canopen serve web -b can0 --bind 0.0.0.0 --name cell7.lan --cert cell7.pem --key cell7.key
    """
    serve_door(
        settings,
        screen,
        bind_door,
        lambda: open_service(settings, screen, allow),
        lambda door, service: tell_web_door(settings, screen, door, service),
        seconds,
    )


def tell_web_door(settings: Settings, screen: Screen, door: WebDoor, service: GatewayService) -> None:
    """Say where the page is, and what it may do."""
    if settings.json:
        allowed = sorted(each.value for each in service.guard.allowed)
        screen.json({"url": door.url, "doors": list(door.addresses), "nets": list(service.nets), "allow": allowed})
    screen.say(f"[bold]open {escape(door.url)}[/]")
    screen.say(f"{escape(service.guard.mode)}; whoever has this address may do that")
    for number, net in enumerate(service.nets, 1):
        screen.say(f"net {number} is {escape(net)}")
