"""`canopen pdo`: what PDOs nodes have set up, another mapping for one of them, and who sends to whom."""

from __future__ import annotations

from typing import Final

import click

from canopen_cli.shared.lazy import LazyGroup

COMMANDS: Final = {
    "show": ("pdo.show", "Show the PDOs of a node: CAN-ID, when they are sent, times, and their objects by name."),
    "map": ("pdo.map:map_pdo", "Give a PDO of a node other objects, or another CAN-ID, type or time, in the order of CiA 301."),
    "check": ("pdo.check", "Compare the PDOs of nodes: who sends to whom, lengths, CAN-IDs with two senders, PDOs nobody takes."),
}


@click.group(cls=LazyGroup, table=COMMANDS)
def pdo() -> None:
    """The PDOs of nodes: show them, map one, compare those of several nodes.

    \b
    canopen pdo show 3 -b demo
    canopen pdo map 5 tpdo2 statusword 6064 --event 100ms --dry-run
    canopen pdo check -b demo
    """
