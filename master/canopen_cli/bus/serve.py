"""`canopen bus serve`: a bus between the terminals of one computer, without hardware and without kernel modules."""

from __future__ import annotations

from collections.abc import Callable

import click
import trio

from canopen_cli.shared.lazy import NamingGroup
from canopen_cli.shared.options import Settings, command, lasting, until_text
from canopen_cli.shared.questions import confirm
from canopen_cli.shared.running import first_error, run_until_interrupted
from canopen_cli.shared.screen import Screen, escape
from canopen_proto.frame import Frame
from canopen_transports.loop.beside import beside
from canopen_transports.record import Record
from canopen_transports.tcp import BusServer, serve_bus
from canopen_transports.tcp.address import DEFAULT_HOST, DEFAULT_PORT, is_loopback, joining
from canopen_transports.tracing import current_trace


@click.group(cls=NamingGroup)
def bus() -> None:
    """Run a bus in software, for several terminals or programs."""


@command(group=bus)
@click.option(
    "--bind", default=DEFAULT_HOST, metavar="HOST", show_default=True, help="Where to listen: an address of this computer."
)
@click.option("--port", type=click.IntRange(0, 65535), default=DEFAULT_PORT, show_default=True, help="0 for any free one.")
@click.option("--yes", is_flag=True, help="Do not ask whether other computers may join.")
@lasting()
def serve(settings: Settings, screen: Screen, bind: str, port: int, yes: bool, seconds: float) -> None:
    """Be a CAN bus until Ctrl-C: all other programs hear what one sends.

    Only programs of this computer can join, unless --bind says otherwise. There is no password: anybody who can reach the port
    hears everything, and can move the drives.

    \b
    canopen bus serve                  the first terminal
    canopen sim -b tcp                 the second: drives
    canopen scan -b tcp                the third

    \b
    canopen bus serve --bind 0.0.0.0 --yes      other computers join by -b tcp:THIS-COMPUTER

    The protocol is text: after the line "canopen-bus 1", `nc localhost 20301` shows each frame as candump would.
    """
    local = is_loopback(bind)
    confirm(screen, f"whoever reaches port {port} of {bind} will hear this bus and can move its drives", yes, needed=not local)
    if not local:
        screen.say(
            f"[yellow]Open to the network:[/] no password guards this bus; whoever reaches port {port} can move its drives."
        )

    def tell(text: str) -> None:
        screen.say(f"[dim]{escape(text)}[/]")

    def recorder() -> Callable[[Frame], None] | None:
        trace = current_trace()
        return None if trace is None else lambda frame: trace.record(Record(trace.now(), "tcp0", frame))

    async def be_a_bus() -> None:
        async with first_error(), beside(trio.open_nursery()) as nursery:
            locators = await nursery.start(serve_bus, bind, port, BusServer(tell, recorder()))
            if settings.json:
                screen.json({"bus": [joining(locator)[0] for locator in locators]})
            for locator in locators:
                screen.say(f"[bold]a bus on {escape(locator)}[/], {until_text(seconds)}")
                here, elsewhere = joining(locator)
                screen.say(f"Join it in other terminals: [bold]canopen sim -b {here}[/], [bold]canopen scan -b {here}[/]")
                if elsewhere:
                    screen.say(f"from other computers: [bold]-b {elsewhere}[/]")
            await trio.sleep(seconds)

    run_until_interrupted(settings, screen, be_a_bus)
