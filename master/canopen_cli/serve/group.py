"""`canopen serve`: let other programs and networks use a machine."""

from __future__ import annotations

from typing import Final

import click

from canopen_cli.shared.lazy import LazyGroup

COMMANDS: Final = {
    "ascii": (
        "serve.ascii:serve_ascii",
        "A text gateway (CiA 309-3) on TCP and a Unix socket, read-only unless it is allowed more.",
    ),
}


@click.group(cls=LazyGroup, table=COMMANDS)
def serve() -> None:
    """Let other programs and networks use a machine: read-only, unless --allow says more."""
