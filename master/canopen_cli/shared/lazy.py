"""A group of commands that imports a command's module only when the command is called.

Its list of commands, in `--help` and in a shell's completion, comes from a table with one line for each. A test compares these
lines with the commands' own help.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any, Final

import click
from click.shell_completion import CompletionItem

from canopen_cli.shared.importing import importing, start_is_over
from canopen_cli.shared.problem import usage

SAME: Final = {
    "diagnose": ("state", "drive state"),
    "status": ("state", "drive state", "scan"),
    "start": ("nmt start",),
    "stop": ("drive stop", "nmt stop"),
    "preop": ("nmt preop",),
    "reboot": ("nmt reset",),
    "error": ("emcy history",),
    "errors": ("emcy history",),
    "sdo": ("read", "write"),
    "bitrate": ("listen --bitrates", "lss set-bitrate"),
    "baudrate": ("listen --bitrates", "lss set-bitrate"),
    "fastscan": ("lss scan",),
    "candump": ("monitor",),
    "tcp": ("ascii", "serve ascii", "bus serve"),
    "http": ("web", "serve web"),
    "gateway": ("ascii", "serve ascii"),
    "upgrade": ("flash",),
    "check": ("lint",),
    "validate": ("lint",),
    "get": ("read",),
    "set": ("write",),
    "upload": ("read",),
    "download": ("write", "flash"),
    "update": ("flash",),
    "firmware": ("flash",),
    "discover": ("scan",),
    "list": ("scan",),
    "ls": ("scan", "list"),
    "sniff": ("monitor",),
    "dump": ("show",),
    "reset": ("fault-reset", "nmt reset", "drive fault-reset", "reset-defaults"),
    "simulate": ("sim",),
    "new": ("init", "from-chains"),
    "create": ("new", "init", "from-chains"),
    "halt": ("stop", "drive stop", "drive disable", "nmt stop"),
    "estop": ("stop", "drive stop", "drive disable", "nmt stop"),
    "quickstop": ("stop", "drive stop"),
    "power": ("enable", "disable", "drive enable", "drive disable"),
    "fault": ("drive state", "drive fault-reset", "emcy history"),
    "statusword": ("state", "drive state"),
    "position": ("drive move", "drive state"),
    "speed": ("velocity", "drive velocity"),
    "homing": ("home",),
    "trajectory": ("move",),
    "path": ("move",),
    "emergency": ("emcy watch", "emcy history"),
    "heartbeat": ("monitor --service heartbeat", "top"),
    "ping": ("info", "scan"),
    "connect": ("doctor",),
    "interfaces": ("doctor",),
    "adapters": ("doctor",),
    "config": ("doctor -v",),
    "configure": ("net boot", "restore"),
    "save": ("store", "backup"),
    "eeprom": ("store",),
    "factory": ("reset-defaults",),
    "id": ("set-id", "lss set-id"),
    "node-id": ("set-id", "lss set-id"),
    "gui": ("tui", "serve web"),
    "viewer": ("tui", "serve web"),
    "metrics": ("serve web",),
    "prometheus": ("serve web",),
    "graph": ("plot", "log plot"),
    "dbc": ("to-dbc", "eds to-dbc"),
    "test": ("check",),
    "conformance": ("check",),
    "emulate": ("sim",),
    "simulator": ("sim",),
    "script": ("run",),
    "python": ("shell", "run"),
    "repl": ("shell",),
}
"""What is called otherwise elsewhere, and the commands here that do it, in whichever group they are."""
NEAR: Final = 0.7
"""How alike two words are, 0 to 1, one of which may be a slip of the other."""


class NamingGroup(click.Group):
    """A group that names the commands that were perhaps meant, if a word is none of them."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        is_word = bool(args) and not args[0].startswith("-")
        if is_word and args[0] not in self.list_commands(ctx) and not ctx.resilient_parsing:
            raise usage("CO001", f"there is no command {args[0]!r}", tries=tuple(self._lines_meant(ctx, args)))
        return super().resolve_command(ctx, args)

    def _lines_meant(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Return the command lines that were perhaps meant, the likeliest first."""
        path = ctx.command_path
        if args[0] == "help":
            return [" ".join((path, *(args[1:] if args[1:2] and args[1] in self.list_commands(ctx) else ()), "--help"))]
        options = [f"--{args[0]}"] if any(f"--{args[0]}" in each.opts for each in self.get_params(ctx)) else []
        lines = [f"{path} {word}" for word in (*options, *self.meant_by(ctx, args[0]))]
        root = ctx.find_root()
        if isinstance(root.command, click.Group) and args[0] in root.command.list_commands(root):
            lines.append(f"{root.command_path} {args[0]}")
        elif not lines and root is not ctx and isinstance(root.command, NamingGroup):
            lines.extend(f"{root.command_path} {word}" for word in root.command.meant_by(root, args[0]))
        return [*lines, f"{path} --help"]

    def meant_by(self, ctx: click.Context, word: str) -> list[str]:
        """Return the commands that a word means elsewhere, that are called so in a group below, or that it is near to."""
        from difflib import get_close_matches

        names = self.list_commands(ctx)
        found = [each for each in SAME.get(word.lower(), ()) if each.split()[0] in names]
        return list(dict.fromkeys((*found, *self.below(ctx, word), *get_close_matches(word.lower(), names, cutoff=NEAR))))

    def below(self, ctx: click.Context, word: str) -> list[str]:
        """Return the commands of groups below that are called so."""
        return []


class LazyGroup(NamingGroup):
    """A group with a table: by the name of a command, its module in canopen_cli and its line. The table gives the order, too.

    "drive.home:home_one" is a command that has another name in its module.
    """

    def __init__(self, *arguments: Any, table: Mapping[str, tuple[str, str]], **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.table = table

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.table)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.table:
            return None
        name, _, function = self.table[cmd_name][0].partition(":")
        with importing():
            module = importlib.import_module(f"canopen_cli.{name}")
        command = getattr(module, function or cmd_name.replace("-", "_"))
        assert isinstance(command, click.Command)
        if not isinstance(command, LazyGroup):  # else there is more to import
            start_is_over()
        return command

    def below(self, ctx: click.Context, word: str) -> list[str]:
        found = []
        for name, (module, _) in self.table.items():
            group = self.get_command(ctx, name) if module == "groups" or module.endswith((".group", ".log")) else None
            if isinstance(group, click.Group) and word in group.list_commands(ctx):
                found.append(f"{name} {word}")
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        limit = formatter.width - 6 - max(map(len, self.table))  # as click.Group has it
        rows = [(name, click.Command(name, help=line).get_short_help_str(limit)) for name, (_, line) in self.table.items()]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        named = [(name, line) for name, (_, line) in self.table.items() if name.startswith(incomplete)]
        options = click.Command.shell_complete(self, ctx, incomplete)
        return [*(CompletionItem(name, help=line) for name, line in named), *options]
