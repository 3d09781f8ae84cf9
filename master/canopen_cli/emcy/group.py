"""`canopen emcy`: emergencies as they come (CiA 301 v4.2.0, 7.2.7), and what a node remembers of its errors (0x1001, 0x1003)."""

from __future__ import annotations

from typing import Final

import click

from canopen_cli.shared.lazy import LazyGroup

COMMANDS: Final = {
    "watch": ("emcy.watch", "Show emergencies in words as they come, of all nodes or of one, until Ctrl-C. Nothing is sent."),
    "history": ("emcy.history", "Show a node's error register (0x1001) and its last errors (0x1003), the newest first."),
    "clear": ("emcy.history", "Have a node forget its last errors: 0 is written to 0x1003:00."),
}


@click.group(cls=LazyGroup, table=COMMANDS)
def emcy() -> None:
    """Emergencies of a bus, and the error history of a node.

    \b
    canopen emcy watch -b demo
    canopen emcy history 3 -b demo
    """
