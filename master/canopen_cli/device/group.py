"""`canopen device`: devices of one's own, written in Python."""

from __future__ import annotations

from typing import Final

import click

from canopen_cli.shared.lazy import LazyGroup

COMMANDS: Final = {
    "new": ("device.new", "Make a device: a Python file that passes `canopen check` as it is."),
    "describe": ("device.describe", "Write the EDS or XDD of a device."),
}


@click.group(cls=LazyGroup, table=COMMANDS)
def device() -> None:
    """Devices of one's own, written in Python: make one, write its file.

    \b
    canopen device new station                        station.py
    canopen device describe station.py -o station.eds
    canopen sim station.py --id 5 -b udp_multicast    serves it
    """
