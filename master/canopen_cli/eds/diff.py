"""`canopen eds diff`: show where two device descriptions differ."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import click

from canopen_cli.shared.eds_files import tell_faults
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_cli.shared.values import plain_json
from canopen_data.difference import Change, Difference, Relative, compare
from canopen_data.named_files import open_description

_MARKS: Final = {Change.ADDED: "[green]+[/]", Change.REMOVED: "[red]-[/]", Change.CHANGED: "[yellow]~[/]"}


@command()
@click.argument("before", metavar="A")
@click.argument("after", metavar="B")
def diff(settings: Settings, screen: Screen, before: str, after: str) -> int:
    """Compare two device descriptions by meaning: EDS, DCF, XDD, XDC, in any mixture.

    Order, spelling, comments and the form of numbers do not matter. Exit status: 0 they say the same, 1 they do not.

    \b
    canopen eds diff old.eds new.eds
    canopen eds diff drive.eds commissioned.dcf --json
    """
    files = [open_description(path, settings.encoding) for path in (before, after)]
    found = compare(*(each.description for each in files))
    if settings.json:
        screen.json([_as_json(each) for each in found])
        return ExitCode.DIFFERENT if found else ExitCode.OK
    for file in files:
        tell_faults(screen, file)
    for each in found:
        screen.out.print(f"{_MARKS[each.change]} {escape(_text(each))}", soft_wrap=True, highlight=False)
    screen.say(f"{counted(len(found), 'difference')} between {escape(before)} and {escape(after)}")
    return ExitCode.DIFFERENT if found else ExitCode.OK


def _text(each: Difference) -> str:
    """Return the text of a change. The mark before it already tells what was added or removed."""
    return str(each) if each.change is Change.CHANGED else f"{each.place} {each.name}".strip()


def _as_json(each: Difference) -> dict[str, Any]:
    return {
        "change": str(each.change),
        "index": each.index,
        "sub": each.subindex,
        "name": each.name,
        "field": each.field or None,
        "before": _value(each.before),
        "after": _value(each.after),
    }


def _value(value: Any) -> Any:
    if isinstance(value, Relative):
        return str(value)
    if isinstance(value, IntEnum):
        return value.name
    if isinstance(value, frozenset):
        return sorted(value)
    return None if value is None else plain_json(value)
