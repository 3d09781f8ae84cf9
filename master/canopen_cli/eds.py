"""`canopen eds`: device descriptions (EDS, DCF, XDD, XDC) looked at, checked, compared, repaired and turned into others.

Its commands are read in only when one of them is called: `canopen scan` needs none of this.
"""

from __future__ import annotations

import importlib
from typing import Final

import click

_COMMANDS: Final = {
    "lint": "eds_lint",
    "show": "eds_show",
    "diff": "eds_diff",
    "fix": "eds_fix",
    "doc": "eds_doc",
    "to-dcf": "eds_dcf",
    "to-cdcf": "eds_dcf",
}
"""Commands, and the modules where they are, in the order in which they are listed."""


class _Commands(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        module = _COMMANDS.get(cmd_name)
        if module is None:
            return None
        command = getattr(importlib.import_module(f"canopen_cli.{module}"), cmd_name.replace("-", "_"))
        assert isinstance(command, click.Command)
        return command


@click.group(cls=_Commands)
def eds() -> None:
    """Device descriptions: EDS, DCF, XDD and XDC files.

    \b
    canopen eds lint drive.eds              what is wrong with it, with line and column
    canopen eds show drive.eds statusword   what it says
    canopen eds doc drive.eds -o drive.html one page to read
    """
