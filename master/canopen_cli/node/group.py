"""`canopen node`: the nodes that a machine file names, and which of them are there."""

from __future__ import annotations

from typing import Final

import click

from canopen_cli.shared.lazy import LazyGroup

COMMANDS: Final = {"list": ("node.list:list_nodes", "List the nodes of a machine file; with -b or --look also which are there.")}


@click.group(cls=LazyGroup, table=COMMANDS)
def node() -> None:
    """The nodes of a machine file: list them, and look which are there.

    \b
    canopen node list cell.toml
    canopen node list cell.toml --look
    """
