"""`canopen eds`: show, check, compare, repair and convert device descriptions (EDS, DCF, XDD, XDC)."""

from __future__ import annotations

from typing import Final

import click

from canopen_cli.shared.lazy import LazyGroup

COMMANDS: Final = {
    "lint": ("eds.lint", "Check device descriptions: EDS, DCF, XDD, XDC."),
    "show": ("eds.show", "Show what a device description says: EDS, DCF, XDD, XDC."),
    "diff": ("eds.diff", "Compare two device descriptions by meaning: EDS, DCF, XDD, XDC, in any mixture."),
    "fix": ("eds.fix", "Repair an EDS or DCF: counts and lists, missing types, forms of numbers, duplicate sections, encoding."),
    "doc": ("eds.doc", "Make one readable page of a device description: HTML that needs nothing else, or Markdown."),
    "stubs": ("eds.stubs", "Write a typed view of a device: a Python file with a key for each object."),
    "to-dcf": ("eds.dcf", "Make a DCF: this device, with this node-ID and these settings."),
    "to-cdcf": ("eds.dcf", "Make a concise DCF: the bytes that object 0x1F22 of a configuration manager takes."),
    "to-dbc": ("eds.dbc", "Make a DBC of a device's PDOs, heartbeat and emergencies, for log tools that know no EDS."),
}


@click.group(cls=LazyGroup, table=COMMANDS)
def eds() -> None:
    """Device descriptions: EDS, DCF, XDD and XDC files.

    \b
    canopen eds lint drive.eds              what is wrong with it, with line and column
    canopen eds show drive.eds statusword   what it says
    canopen eds doc drive.eds -o drive.html one page to read
    """
