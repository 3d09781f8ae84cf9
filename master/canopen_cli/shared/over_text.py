"""`-b gw:HOST:PORT`: commands over a text gateway (CiA 309-3), ours or another maker's.

It carries no frames. So a command that reads, writes or commands nodes has a second way, over `RemoteGateway`; every other
command says that it needs a bus (`check_has_way`).
"""

from __future__ import annotations

from typing import Final

from canopen_cli.shared.options import Settings
from canopen_cli.shared.problem import usage
from canopen_gateway.ascii.address import SCHEME
from canopen_gateway.errors import NotOverTextError

WORKS: Final = "read, write, nmt, scan"
"""The commands that have a way over a text gateway."""


def is_text_gateway(bus: str | None) -> bool:
    """Return whether a bus is a text gateway."""
    return bus is not None and bus.startswith(SCHEME)


def check_has_way(bus: str | None) -> None:
    """Raise NotOverTextError if a bus is a text gateway: for a command that has no way over one."""
    if bus is not None and is_text_gateway(bus):
        raise NotOverTextError(bus, WORKS)


def refuse_over_text(settings: Settings, **options: object) -> None:
    """Raise a CommandError if options were given that need a bus, though it is a text gateway. options: by their names on the
    command line; those that are not given are None or False."""
    given = [name.replace("_", "-") for name, value in options.items() if value]
    bus = settings.named_bus()
    if given and is_text_gateway(bus):
        failed = f"--{given[0]} does not work over {bus}: a text gateway carries no frames"
        raise usage("CO156", failed, tries=("the same without it",))
