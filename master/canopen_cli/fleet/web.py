"""`canopen fleet web`: the page over a fleet."""

from __future__ import annotations

from typing import Final

import trio

from canopen_cli.fleet.joining import WayIn, joining
from canopen_cli.shared.options import Settings, command, lasting
from canopen_cli.shared.permissions import allowing
from canopen_cli.shared.problem import usage
from canopen_cli.shared.running import first_error, run_until_interrupted
from canopen_cli.shared.screen import Screen, escape
from canopen_cli.shared.web_address import BindDoor, web_address
from canopen_gateway import Guard, Permission
from canopen_gateway.web import WebDoor

NOT_OVER_A_FLEET: Final = {
    Permission.MOTION: "a dead man's switch needs a short way to the machine",
    Permission.LSS: "no bridge has layer setting services",
}


@command()
@web_address
@allowing
@lasting()
@joining
def web(
    settings: Settings,
    screen: Screen,
    bind_door: BindDoor,
    allow: frozenset[Permission],
    seconds: float,
    way_in: WayIn,
) -> None:
    """Serve the machines of a fleet as a page in a browser, and by HTTP, until Ctrl-C. Needs the extras `web` and `fleet`.

    Open the address that it prints: the token in it is the key. Reading is always allowed. A change goes only if both allow it:
    this page, and the bridge of the site, each by its --allow. Anybody who has the token may halt all sites, always.

    It begins also where no bridge is there yet. There is no motion (--allow motion) over a fleet, and no layer setting service.

    \b
    canopen fleet web --connect tcp/192.168.1.20:7447
    canopen fleet web --connect tls/plant:7447 --zenoh office.json5 --allow write
    """
    for never in sorted(NOT_OVER_A_FLEET.keys() & allow, key=lambda each: each.value):
        tries = (f"the same without {never.value}", "canopen serve web, on the computer that has the bus")
        raise usage("CO123", f"--allow {never.value}: not over a fleet, since {NOT_OVER_A_FLEET[never]}", tries=tries)

    @first_error()
    async def serve() -> None:
        door = await bind_door()
        async with door, way_in.open() as fleet:
            _tell(settings, screen, door, allow, way_in.connect)
            with trio.move_on_after(seconds):
                await door.serve_fleet(fleet, allow)
        if door.failure is not None:
            raise door.failure

    run_until_interrupted(settings, screen, serve)


def _tell(settings: Settings, screen: Screen, door: WebDoor, allow: frozenset[Permission], connect: tuple[str, ...]) -> None:
    if settings.json:
        allowed = sorted(each.value for each in allow)
        screen.json({"url": door.url, "doors": list(door.addresses), "connect": list(connect), "allow": allowed})
    screen.say(f"[bold]open {escape(door.url)}[/]")
    screen.say(f"{escape(Guard(allow).mode)}, as far as each bridge allows it; whoever has this address may do that")
