"""`canopen data init`: copy the installed data files to a folder where the user can change them."""

from __future__ import annotations

from pathlib import Path

import click

import canopen_data
from canopen_cli.shared.lazy import NamingGroup
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.screen import Screen, escape

_STYLES = {"created": "green", "replaced": "yellow", "kept": "yellow", "unchanged": "dim"}


@click.group(cls=NamingGroup)
def data() -> None:
    """The object dictionary and the chain files."""


@command(group=data)
@click.option(
    "-o",
    "--output",
    "target",
    metavar="FOLDER",
    type=click.Path(file_okay=False, path_type=Path),
    help="Another folder than ~/.canopen.",
)
def init(settings: Settings, screen: Screen, target: Path | None) -> None:
    """Copy the data files to ~/.canopen (or $CANOPEN_DATA).

    A file there replaces the installed one of the same name. Files that you changed are kept, unless --force is given.

    \b
    canopen data init
    """
    copied = canopen_data.init(target, force=settings.force)
    if settings.json:
        screen.json([{"path": str(each.path), "action": each.action} for each in copied])
        return
    for each in copied:
        screen.say(f"[{_STYLES[each.action]}]{each.action:<10}[/]{escape(str(each.path))}")
    kept = [each.path.name for each in copied if each.action == "kept"]
    folder = copied[0].path.parent
    if kept:
        screen.say(f"{', '.join(kept)}: changed by you, so left alone. [bold]canopen data init --force[/] replaces them.")
    where = f"with CANOPEN_DATA={folder} the files there" if target is not None else f"files in {folder}"
    screen.say(f"From now on {escape(where)} are used instead of the installed ones.")
