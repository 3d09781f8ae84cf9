"""`canopen log diff`: what two recordings show differently: nodes, CAN-IDs and their rates, and the last values of objects."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, Final, NamedTuple

import click

from canopen_cli.live.frame_lines import WantedFrames
from canopen_cli.live.log_values import LoggedValue, values_in
from canopen_cli.live.reading import watched
from canopen_cli.live.source import frames_of, reader_of
from canopen_cli.live.window import Window, windowed
from canopen_cli.shared.options import FILE, NodeIds, Settings, command
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_proto.machine import SECOND
from canopen_proto.observer.observer import Observer

COLUMNS: Final = ("what", "one", "other")


class LogDifference(NamedTuple):
    """Something that two recordings show differently. kind: "CAN-ID", "rate" or "value". one, other: None: not there."""

    kind: str
    what: str
    one: Any
    other: Any


class Traffic(NamedTuple):
    """What a recording shows. rates: frames per second by CAN-ID, as candump writes it. names: what each of these carries.
    values: the last value of each object."""

    rates: dict[str, float]
    names: dict[str, str]
    values: dict[str, LoggedValue]


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
    first, second = (_traffic(settings, screen, each, nodes, window.again()) for each in (one, other))
    found = [*_rates(first, second, rate / 100), *_values(first, second)]
    if settings.json:
        screen.json({"one": str(one), "other": str(other), "differences": [each._asdict() for each in found]})
    elif found:
        screen.table(COLUMNS, [(f"{each.kind} {escape(each.what)}", _text(each.one), _text(each.other)) for each in found])
    screen.say(counted(len(found), "difference"))
    return ExitCode.DIFFERENT if found else ExitCode.OK


def _traffic(settings: Settings, screen: Screen, source: Path, nodes: tuple[int, ...] | None, window: Window) -> Traffic:
    counts: Counter[str] = Counter()
    names: dict[str, str] = {}
    observer = Observer()
    first: int | None = None
    begun = last = None
    reader = reader_of(source)
    for record in watched(screen, reader, frames_of(reader)):
        first = record.time if first is None else first
        if not window.has(record.time, first):
            continue
        begun = record.time if begun is None else begun
        last = record.time
        key = str(record.frame).partition("#")[0]
        counts[key] += 1
        if key not in names:
            meaning = observer.observe(record.frame, record.time - first).meaning
            service = "heartbeat" if meaning.service == "boot-up" else meaning.service
            names[key] = f"{service} of node {meaning.node_id}" if meaning.node_id else service
    seconds = max((last or 0) - (begun or 0), SECOND) / SECOND
    values = {value.label: value for value in values_in(settings, screen, source, WantedFrames(nodes), window)}
    return Traffic({key: count / seconds for key, count in counts.items()}, names, values)


def _rates(one: Traffic, other: Traffic, allowed: float) -> list[LogDifference]:
    found = []
    for key in sorted(one.rates.keys() | other.rates.keys()):
        name = f"{key} ({one.names.get(key) or other.names[key]})"
        first, second = one.rates.get(key), other.rates.get(key)
        if first is None or second is None:
            found.append(LogDifference("CAN-ID", name, _there(first), _there(second)))
        elif abs(first - second) > allowed * max(first, second):
            found.append(LogDifference("rate", name, f"{first:.3g}/s", f"{second:.3g}/s"))
    return found


def _there(rate: float | None) -> str | None:
    return None if rate is None else f"{rate:.3g}/s"


def _values(one: Traffic, other: Traffic) -> list[LogDifference]:
    found = []
    for label in sorted(one.values.keys() | other.values.keys()):
        first, second = ((each.values[label].plain if label in each.values else None) for each in (one, other))
        if first != second:
            found.append(LogDifference("value", label, first, second))
    return found


def _text(value: Any) -> str:
    return "not there" if value is None else escape(str(value))
