"""A group of commands that imports a command's module only when the command is called.

Its list of commands, in `--help` and in a shell's completion, comes from a table with one line for each. A test compares these
lines with the commands' own help.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import click
from click.shell_completion import CompletionItem

from canopen_cli.shared.importing import importing


class LazyGroup(click.Group):
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
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        limit = formatter.width - 6 - max(map(len, self.table))  # as click.Group has it
        rows = [(name, click.Command(name, help=line).get_short_help_str(limit)) for name, (_, line) in self.table.items()]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        named = [(name, line) for name, (_, line) in self.table.items() if name.startswith(incomplete)]
        options = click.Command.shell_complete(self, ctx, incomplete)
        return [*(CompletionItem(name, help=line) for name, line in named), *options]
