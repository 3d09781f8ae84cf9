"""`canopen fleet router`: pass on what bridges and viewers say."""

from __future__ import annotations

from pathlib import Path

import click
import trio

from canopen_cli.fleet.joining import Endpoint, or_default, zenoh_file
from canopen_cli.shared.options import Settings, command, lasting
from canopen_cli.shared.running import run_until_interrupted
from canopen_cli.shared.screen import Screen, escape
from canopen_gateway.fleet.joining import DEFAULT_ENDPOINT, close_zenoh, open_zenoh


@command()
@click.option(
    "--listen", type=Endpoint(), multiple=True, metavar="ENDPOINT", help=f"Where to listen.  [default: {DEFAULT_ENDPOINT}]"
)
@click.option("--connect", type=Endpoint(), multiple=True, metavar="ENDPOINT", help="A router above this one; may be repeated.")
@zenoh_file
@click.option("--reachable", is_flag=True, help="Other computers may come in, though nobody proves who he is.")
@lasting()
def router(
    settings: Settings,
    screen: Screen,
    listen: tuple[str, ...],
    connect: tuple[str, ...],
    config: Path | None,
    reachable: bool,
    seconds: float,
) -> None:
    """Pass on what bridges and viewers of a fleet say, until Ctrl-C. It owns no bus.

    Bridges and viewers connect to it; so only one port has to be known. Routers stand in a tree: that of a hall
    connects to that of the plant.

    \b
    canopen fleet router --listen tcp/0.0.0.0:7447 --zenoh plant.json5
    canopen serve zenoh --site hall-2 -m cell.toml --connect tcp/plant:7447
    """
    endpoints = or_default(listen, config)

    async def serve() -> None:
        session = await open_zenoh(connect=connect, listen=endpoints, config=config, reachable=reachable, mode="router")
        try:
            if settings.json:
                screen.json({"listen": list(endpoints)})
            screen.say(f"[bold]a router of a fleet at {escape(', '.join(endpoints) or str(config))}[/]")
            with trio.move_on_after(seconds):
                await trio.sleep_forever()
        finally:
            await close_zenoh(session)

    run_until_interrupted(settings, screen, serve)
