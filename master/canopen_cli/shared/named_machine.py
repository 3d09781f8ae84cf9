"""The machine file as an argument: of all commands that are about a whole machine. -m and CANOPEN_MACHINE name it too."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click

from canopen_cli.shared.options import FILE, Settings
from canopen_cli.shared.problem import usage
from canopen_master.machine_file import MachineFile

_YAML: Final = (".yaml", ".yml")

machine_argument = click.argument("file", metavar="[MACHINE]", type=FILE, required=False)
"""The machine file; without it that of -m or CANOPEN_MACHINE."""


def machine_of(settings: Settings, path: Path | None) -> MachineFile | None:
    """Return the machine of the argument, else of -m or CANOPEN_MACHINE, or None. Raises a CommandError, DataError,
    DictionaryError."""
    if path is not None and path.suffix.lower() in _YAML:
        raise usage("CO123", f"{path} is no machine file", tries=(f"canopen machine import {path} -o cell.toml",))
    if path is not None:
        settings.machine = path
    return settings.machine_file()


def named_machine(settings: Settings, path: Path | None) -> MachineFile:
    """Return the machine as `machine_of` does. Raises a CommandError if none was named."""
    machine = machine_of(settings, path)
    if machine is None:
        first = ("canopen net init -o cell.toml -b can0    (writes one of a scan)", "-m cell.toml")
        raise usage("CO121", "no machine file was named", tries=first)
    return machine
