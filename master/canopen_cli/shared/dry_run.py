"""`--dry-run` of commands that run as they are, while nothing is sent but what reads: see withholding.py."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TypeVar

import click

from canopen_cli.shared.options import Settings
from canopen_cli.shared.running import Story, run
from canopen_cli.shared.screen import Screen

T = TypeVar("T")


def run_or_show(
    settings: Settings,
    screen: Screen,
    command: Callable[[], Awaitable[T]],
    *,
    story: Story = lambda confirmed: [],
    over_text: bool = False,
) -> T:
    """Run a command and return its result, as `run`. With --dry-run show what it would send; the program ends with that."""
    if not settings.dry_run:
        return run(settings, screen, command, story=story, over_text=over_text)
    from canopen_cli.shared.withholding import show_unsent  # only here: it needs much that `canopen write` does not

    show_unsent(settings, screen, command)
    raise click.exceptions.Exit
