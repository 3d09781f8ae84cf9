"""`canopen net`: the network of a machine file: check it, boot it, watch it (CiA 302-2)."""

from __future__ import annotations

from typing import Final

import click

from canopen_cli.shared.lazy import LazyGroup

COMMANDS: Final = {
    "init": ("net.init", "Write a machine file of the nodes that a scan finds."),
    "check": ("net.check", "Compare each node with the machine file; nothing is written."),
    "boot": ("net.boot", "Reset, check, configure and start the nodes of a machine file."),
    "watch": ("net.boot", "Boot the nodes, then boot those that come back, and react to lost ones, until Ctrl-C."),
    "links": ("net.links", "Show the PDOs for the links of a machine file: CAN-IDs, mappings, transmission types."),
}


@click.group(cls=LazyGroup, table=COMMANDS)
def net() -> None:
    """The network of a machine file: check it, boot it, watch it (CiA 302-2).

    \b
    canopen net init -o cell.toml -b can0     from a scan
    canopen net check cell.toml               is each node as the file says? Nothing is written
    canopen net boot cell.toml                reset, check, configure, start; with -b demo simulated
    canopen net links cell.toml               the PDOs by which its nodes feed each other
    """
