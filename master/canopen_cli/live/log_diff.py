"""`canopen log diff`: what two recordings show differently: nodes, CAN-IDs and their rates, and the last values of objects."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, NamedTuple

import click

from canopen_cli.live.frame_lines import WantedFrames
from canopen_cli.live.log_traffic import Traffic, traffic_in
from canopen_cli.live.log_values import LoggedValue, values_in
from canopen_cli.live.source import reader_of
from canopen_cli.live.window import Window, windowed
from canopen_cli.shared.options import FILE, NodeIds, Settings, command
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.screen import Screen, counted, escape

COLUMNS: Final = ("what", "one", "other")


class LogDifference(NamedTuple):
    """Something that two recordings show differently. kind: "CAN-ID", "rate" or "value". one, other: None: not there."""

    kind: str
    what: str
    one: Any
    other: Any


class Shown(NamedTuple):
    """What a recording shows. rates: frames per second by CAN-ID, as candump writes it; None where the recording is too short to
    tell. names: what each of these carries. values: the last value of each object, as JSON has it. Of a recording with several
    buses, CAN-IDs and objects have the bus before them."""

    rates: dict[str, float | None]
    names: dict[str, str]
    values: dict[str, Any]


@command("diff")
@click.argument("one", metavar="ONE", type=FILE)
@click.argument("other", metavar="OTHER", type=FILE)
@click.option("--node", "nodes", type=NodeIds(), help="Only values of these nodes: 5, or 3-8.")
@click.option(
    "--rate", type=click.FloatRange(0), default=20.0, metavar="PERCENT", help="By how much rates may differ.  [default: 20]"
)
@windowed
def diff(
    settings: Settings, screen: Screen, one: Path, other: Path, nodes: tuple[int, ...] | None, rate: float, window: Window
) -> int:
    """Compare two recordings: CAN-IDs that only one has, rates, and the last values of objects. Exit status: 1 with differences.
    --since and --until are those of each recording.

    \b
    canopen log diff before.log after.log
    canopen log diff good.log bad.log -e 5=drive.eds --node 5
    """
    (first, one_values), (second, other_values) = (_read(settings, screen, each, nodes, window) for each in (one, other))
    has_several = max(len(first.channels), len(second.channels)) > 1
    mine, others = _shown(first, one_values, has_several), _shown(second, other_values, has_several)
    found = [*_rates(mine, others, rate / 100), *_values(mine, others)]
    if not (first.span and second.span):
        screen.say("[yellow]a recording is too short for a rate: rates are not compared[/]")
    if settings.json:
        screen.json({"one": str(one), "other": str(other), "differences": [each._asdict() for each in found]})
    elif found:
        screen.table(COLUMNS, [(f"{each.kind} {escape(each.what)}", _text(each.one), _text(each.other)) for each in found])
    screen.say(counted(len(found), "difference"))
    return ExitCode.DIFFERENT if found else ExitCode.OK


def _read(
    settings: Settings, screen: Screen, source: Path, nodes: tuple[int, ...] | None, window: Window
) -> tuple[Traffic, list[LoggedValue]]:
    """Return the frames and the last values of objects in a part of a recording."""
    traffic = traffic_in(screen, reader_of(source), window.again())
    found = values_in(settings, screen, source, WantedFrames(nodes), window.again())
    return traffic, list({(each.record.channel, each.label): each for each in found}.values())


def _shown(traffic: Traffic, values: list[LoggedValue], has_several: bool) -> Shown:
    rates: dict[str, float | None] = {}
    names: dict[str, str] = {}
    for each in traffic.ids:
        key = f"{each.channel} {each.can_id}" if has_several else each.can_id
        rate = traffic.per_second(each.frames)
        before = rates.get(key)
        rates[key] = rate if before is None or rate is None else before + rate  # a remote frame and its answer have one CAN-ID
        names.setdefault(key, f"{each.service} of node {each.node_id}" if each.node_id else each.service)
    labels = {(f"{each.record.channel} " if has_several else "") + each.label: each.plain for each in values}
    return Shown(rates, names, labels)


def _rates(one: Shown, other: Shown, allowed: float) -> list[LogDifference]:
    found = []
    for key in sorted(one.rates.keys() | other.rates.keys()):
        name = f"{key} ({one.names.get(key) or other.names[key]})"
        first, second = one.rates.get(key), other.rates.get(key)
        if key not in one.rates or key not in other.rates:
            there = (_there(each, key) for each in (one, other))
            found.append(LogDifference("CAN-ID", name, *there))
        elif first is not None and second is not None and abs(first - second) > allowed * max(first, second):
            found.append(LogDifference("rate", name, f"{first:.3g}/s", f"{second:.3g}/s"))
    return found


def _there(shown: Shown, key: str) -> str | None:
    """Return how often a CAN-ID comes, in words; None if it does not."""
    rate = shown.rates.get(key)
    return None if key not in shown.rates else "there" if rate is None else f"{rate:.3g}/s"


def _values(one: Shown, other: Shown) -> list[LogDifference]:
    found = []
    for label in sorted(one.values.keys() | other.values.keys()):
        first, second = one.values.get(label), other.values.get(label)
        if first != second:
            found.append(LogDifference("value", label, first, second))
    return found


def _text(value: Any) -> str:
    return "not there" if value is None else escape(str(value))
