"""The configuration file: what a user would else say by CANOPEN_BUS and CANOPEN_MACHINE, once for all shells.

It is one place: $XDG_CONFIG_HOME/canopen/config.toml, by default ~/.config/canopen/config.toml. An option goes before a variable,
and a variable before the file; a bus of the variable CANOPEN_BUS also before a machine of the file.

    bus = "socketcan:can0"
    machine = "cells/cell7.toml"        # beside this file, if it is no absolute path
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from canopen_cli.shared.problem import CommandError, ExitCode

NAME: Final = Path("canopen", "config.toml")
FOLDER_VARIABLE: Final = "XDG_CONFIG_HOME"
KEYS: Final = ("bus", "machine")


@dataclass(frozen=True)
class Configuration:
    """What the file says. path: of it; None: there is none. bus, machine: None: it does not name one."""

    path: Path | None = None
    bus: str | None = None
    machine: Path | None = None


def configuration_path() -> Path | None:
    """Return where the file is, or would be; None if this user has no home."""
    named = os.environ.get(FOLDER_VARIABLE, "")
    try:
        folder = Path(named) if Path(named).is_absolute() else Path.home() / ".config"  # the XDG rule: else it is ignored
    except RuntimeError:
        return None
    return folder / NAME


def read_configuration() -> Configuration:
    """Return what the file says. Raises a CommandError if it cannot be used: nothing is guessed."""
    path = configuration_path()
    try:
        if path is None or not path.is_file():
            return Configuration()
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise _unusable(f"{path} cannot be read", str(error)) from error
    import tomllib  # only for those who have such a file

    try:
        found: dict[str, Any] = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise _unusable(f"{path} is no TOML", str(error)) from error
    for key, value in found.items():
        if key not in KEYS:
            raise _unusable(f"{path}: there is no key {key!r}", f"the keys are {', '.join(KEYS)}")
        if not isinstance(value, str) or not value:
            raise _unusable(f"{path}: {key} = {value!r} is no text", "")
    machine = found.get("machine")
    return Configuration(path, found.get("bus"), None if machine is None else path.parent / Path(machine).expanduser())


def _unusable(failed: str, seen: str) -> CommandError:
    return CommandError(ExitCode.BAD_FILE, "CO301", failed, seen=seen, tries=("correct it, or take it away",))
