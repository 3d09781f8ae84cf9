"""`canopen lss`: node-IDs and bit rates over the bus (CiA 305)."""

from __future__ import annotations

from typing import Final

import click

from canopen_cli.shared.lazy import LazyGroup

COMMANDS: Final = {
    "scan": ("lss.find", "Find the devices without a node-ID, and show their addresses."),
    "identify": ("lss.find", "Find all devices of a type, with and without a node-ID."),
    "inquire": ("lss.find", "Show the LSS address and the node-ID of one device."),
    "set-id": ("lss.set", "Give one device a node-ID, or another one."),
    "store": ("lss.set", "Let one device store its node-ID and bit rate."),
    "assign": ("lss.set", "Give all devices without a node-ID theirs, in order or by a table."),
    "set-bitrate": ("lss.rate", "Change the bit rate of all devices of a bus."),
}


@click.group(cls=LazyGroup, table=COMMANDS)
def lss() -> None:
    """Give devices their node-ID and bit rate over the bus itself (CiA 305).

    \b
    canopen bus serve                               the first terminal: a bus without hardware
    canopen sim --id 255,255,255 -b tcp             the second: three drives without a node-ID
    canopen lss assign --ids 10-20 -b tcp           the third
    """
