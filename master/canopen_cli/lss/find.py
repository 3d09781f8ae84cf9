"""`canopen lss scan`, `identify` and `inquire`: nothing is written."""

from __future__ import annotations

import click

from canopen_cli.lss.support import (
    LssTarget,
    NumberBounds,
    TargetKind,
    Unsigned32,
    address_text,
    device_of,
    estimate,
    knowing,
    limited,
    node_id_text,
    open_lss,
    progress,
    windowed,
)
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_cli.shared.values import identity_json
from canopen_proto.lss.messages import UNCONFIGURED, LssAddress
from canopen_proto.lss.scan import ALL_ONES, NOTHING_KNOWN, Known, Survey, search, survey
from canopen_proto.machine import Time

COLUMNS = ("vendor-ID", "product code", "revision", "serial number")


@command()
@knowing
@windowed
@limited
def scan(settings: Settings, screen: Screen, known: Known, window: Time, limit: Time) -> int:
    """Find the devices without a node-ID, and show their addresses. Nothing is written. Exit status 5: none was found.

    \b
    canopen lss scan --vendor 0x360 -b can0
    """

    async def find() -> Survey:
        async with open_lss(settings, screen, window, limit) as lss, progress(lss, screen, known):
            screen.say(f"[dim]{estimate(lss.pace, known)}[/]")
            return await lss.run(survey(lss.tool, lss.pace, known))

    result = run(settings, screen, find)
    _show(settings, screen, result.found)
    screen.say(f"{counted(len(result.found), 'device')} without a node-ID{_matching(known != NOTHING_KNOWN)}")
    if result.again is not None:
        screen.say(
            f"[yellow]{escape(address_text(result.again))} takes part in the scan though it was found already: devices with "
            "higher addresses may be hidden behind it. canopen lss identify finds them.[/]"
        )
    return ExitCode.OK if result.found else ExitCode.NO_ANSWER


def _matching(chosen: bool) -> str:
    return ", with these numbers" if chosen else ""


@command()
@click.option("--vendor", type=Unsigned32(), required=True, help="The vendor-ID.")
@click.option("--product", type=Unsigned32(), required=True, help="The product code.")
@click.option(
    "--revision", type=NumberBounds(), default=(0, ALL_ONES), help="Revisions, inclusive: 0x10000-0x1FFFF.  [default: all]"
)
@click.option("--serial", type=NumberBounds(), default=(0, ALL_ONES), help="Serial numbers, inclusive: 1-100.  [default: all]")
@windowed
def identify(
    settings: Settings,
    screen: Screen,
    vendor: int,
    product: int,
    revision: tuple[int, int],
    serial: tuple[int, int],
    window: Time,
) -> None:
    """Find all devices of a type, with and without a node-ID. Nothing is written.

    It halves ranges of revisions and serial numbers, and needs no fastscan. Some devices (CANopenNode's) do not know this.

    \b
    canopen lss identify --vendor 0x360 --product 2 --serial 1-1000 -b can0
    """

    async def find() -> list[LssAddress]:
        async with open_lss(settings, screen, window) as lss, progress(lss, screen, (vendor, product, None, None)):
            return await lss.run(search(lss.tool, lss.pace, vendor, product, revision, serial))

    found = run(settings, screen, find)
    if not found:
        raise CommandError(
            ExitCode.NO_ANSWER,
            "CO211",
            "nobody answered; some devices know only fastscan (CANopenNode's)",
            cause="no such device, no power, another bit rate; or it does not know this service",
            tries=("canopen lss scan    (devices without a node-ID, by fastscan)", "canopen scan    (devices with one)"),
        )
    _show(settings, screen, found)
    screen.say(f"{counted(len(found), 'device')} of this type")


@command()
@click.argument("device", metavar="DEVICE", type=TargetKind())
@windowed
def inquire(settings: Settings, screen: Screen, device: LssTarget, window: Time) -> None:
    """Show the LSS address and the node-ID of one device. Nothing is written.

    DEVICE: its LSS address, its node-ID, or `only` if it is the only one on the bus.

    \b
    canopen lss inquire only -b can0
    """

    async def ask() -> tuple[LssAddress, int]:
        async with open_lss(settings, screen, window) as lss:
            return await device_of(lss, device)

    address, node_id = run(settings, screen, ask)
    if settings.json:
        screen.json({**identity_json(address), "node": None if node_id == UNCONFIGURED else node_id})
        return
    screen.data(f"{address_text(address)}  node-ID {node_id_text(node_id)}")


def _show(settings: Settings, screen: Screen, addresses: list[LssAddress]) -> None:
    if settings.json:
        screen.json([identity_json(address) for address in addresses])
    elif addresses:
        screen.table((*COLUMNS, "address"), [(*(f"0x{number:08X}" for number in each), address_text(each)) for each in addresses])
