"""`canopen sim`: simulated drives on any bus, for other programs or another terminal to play with."""

from __future__ import annotations

import math
from typing import Final

import click
import trio

from canopen_master.cli.fleet import DEMO_LOCATOR, DEMO_NODES, simulated_fleet
from canopen_master.cli.options import DEMO, NodeIds, Settings, common
from canopen_master.cli.problem import ExitCode, Problem
from canopen_master.cli.running import run
from canopen_master.cli.screen import node_text
from canopen_proto.cia402.drive import DriveFault, DriveStateChanged
from canopen_proto.cia402.servo import Shape
from canopen_proto.error_codes import error_text
from canopen_proto.machine import Event
from canopen_proto.nmt import NmtStateChanged

SHAPES: Final = {"schunk": Shape.SCHUNK_POWERBALL, "standard": Shape.STANDARD}
DEFAULT_IDS: Final = f"{DEMO_NODES[0]}-{DEMO_NODES[-1]}"


@click.command()
@click.option("--ids", "node_ids", type=NodeIds(), default=DEFAULT_IDS, show_default=True, help="Their node-IDs.")
@click.option(
    "--shape", type=click.Choice(list(SHAPES)), default="schunk", show_default=True, help="Powerball joints, or CiA 402."
)
@click.option("--seconds", type=click.FloatRange(0), help="End after this time, instead of by Ctrl-C.")
@common
@click.pass_obj
def sim(settings: Settings, node_ids: tuple[int, ...], shape: str, seconds: float | None) -> None:
    """Serve simulated drives on a bus until Ctrl-C.

    Two terminals without hardware meet on udp_multicast:

    \b
    canopen sim -b udp_multicast
    canopen demo -b udp_multicast
    """
    screen = settings.screen()
    bus = settings.required_bus("-b udp_multicast               another terminal of this computer can join")
    locator = DEMO_LOCATOR if bus == DEMO else bus

    def tell(event: Event) -> None:
        match event:
            case NmtStateChanged(node_id=node_id, state=state):
                screen.say(f"{node_text(node_id)}  NMT {state.name.lower().replace('_', '-')}")
            case DriveStateChanged(node_id=node_id, state=state):
                screen.say(f"{node_text(node_id)}  {state}")
            case DriveFault(node_id=node_id, error_code=code):
                screen.say(f"{node_text(node_id)}  [red]fault 0x{code:04X} {error_text(code)}[/]")

    async def serve() -> None:
        drives = f"{len(node_ids)} simulated drive{'s' if len(node_ids) > 1 else ''}"
        screen.say(f"[bold]{drives} on {bus}[/], {'until Ctrl-C' if seconds is None else f'for {seconds:g} s'}")
        if locator.startswith("virtual:"):
            screen.say("That bus ends with this process: with -b udp_multicast another terminal can join.")
        async with simulated_fleet([(locator, node_id) for node_id in node_ids], SHAPES[shape], tell):
            await trio.sleep(math.inf if seconds is None else seconds)

    try:
        run(settings, screen, serve)
    except Problem as ended:
        if ended.exit_code is not ExitCode.INTERRUPTED:
            raise
        screen.say("ended")  # as it was to end
