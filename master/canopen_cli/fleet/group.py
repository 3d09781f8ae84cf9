"""`canopen fleet`: many buses on many computers, which `canopen serve zenoh` brings together."""

from __future__ import annotations

from typing import Final

import click

from canopen_cli.shared.lazy import LazyGroup

COMMANDS: Final = {
    "ls": ("fleet.looking", "List the buses and nodes of a fleet."),
    "read": ("fleet.looking", "Read objects of nodes of a fleet, side by side."),
    "watch": ("fleet.watching", "Tell what happens in a fleet, until Ctrl-C: who comes and goes, states, emergencies, PDOs."),
    "halt": ("fleet.halting", "Stop what moves, at one place or everywhere. Anybody may."),
    "web": ("fleet.web", "Serve the machines of a fleet as a page in a browser, and by HTTP, until Ctrl-C."),
    "record": ("fleet.record", "Record a fleet as Parquet, by site, node and hour, until Ctrl-C."),
    "query": ("fleet.query", "Ask what a fleet was: values of nodes and objects, or SQL."),
    "router": ("fleet.router", "Pass on what bridges and viewers say, until Ctrl-C."),
}


@click.group(cls=LazyGroup, table=COMMANDS)
def fleet() -> None:
    """Many buses on many computers, which `canopen serve zenoh` brings together.

    \b
    canopen serve zenoh --site hall-2 -b demo --listen tcp/127.0.0.1:7447     the first terminal
    canopen fleet ls                                                        the second
    canopen fleet read '*/*/*' 1008

    A place is SITE/BUS/NODE; * stands for each.
    """
