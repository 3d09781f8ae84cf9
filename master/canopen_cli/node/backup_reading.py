"""Read all objects of a node, with progress, and tell what is missing: for `backup`, `compare`, `dump` and `restore`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final, TypeVar

import click
import trio
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn

from canopen_cli.shared.options import TextKind, option_group
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen, escape, node_text
from canopen_cli.shared.session import BusSession
from canopen_cli.shared.values import as_json, hex_text, object_json, place_text, value_text
from canopen_master.participant.subscription import Subscription
from canopen_master.way_back import RESULT_WORDS
from canopen_proto.abort import text_of
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Variable
from canopen_proto.machine import Event
from canopen_proto.manager.parameters.backup import Backup, ObjectRead, Reading, ReadResult, back_up
from canopen_proto.manager.parameters.walk import WalkProgress, back_up_by_names, walk
from canopen_proto.procedures.steps import Procedure
from canopen_transports.loop.beside import beside

T = TypeVar("T")

REDRAW: Final = 0.1
"""Seconds between two updates of the progress."""
MAX_LISTED: Final = 10
"""Unread objects that are listed; the rest is counted, and listed with -v."""

_RANGE: Final = re.compile(r"\s*(?:0[xX])?([0-9A-Fa-f]{1,4})\s*(?:-\s*(?:0[xX])?([0-9A-Fa-f]{1,4})\s*)?")


class Indices(TextKind):
    """Ranges of indices, in hexadecimal: "1000-1FFF,6000-67FF"."""

    name = "indices"

    def read(self, text: str) -> tuple[range, ...]:
        ranges = []
        for part in text.split(","):
            match = _RANGE.fullmatch(part)
            first = int(match[1], 16) if match is not None else 0
            last = int(match[2] or match[1], 16) if match is not None else 0
            if not 0 < first <= last:
                raise ValueError(f"{part.strip()!r} is not a range of indices such as 1000-1FFF")
            ranges.append(range(first, last + 1))
        return tuple(ranges)


reading_options: Final = option_group(
    click.option(
        "--walk",
        "indices",
        type=Indices(),
        metavar="1000-1FFF,...",
        help="Ask for all objects at these indices, whatever the dictionary says: for a device without a file.",
    ),
    click.option("--domains", is_flag=True, help="Read DOMAIN objects too: firmware, recordings ... These can be long."),
)
"""The options that say what is to be read. The command takes `indices` and `domains`."""


async def read_all(session: BusSession, screen: Screen, node_id: int, indices: tuple[range, ...] | None, domains: bool) -> Backup:
    """Read what a node holds: by its own file; without one by a walk and the data files; or by a walk over `indices`. Raises
    SdoTransferError if the node is gone. domains: also objects of type DOMAIN."""
    node = session.node(node_id).remote
    label = f"reading {node_text(node_id)}"
    if indices is not None:
        return await shown(session, screen, label, walk(node, indices, domains=domains), WalkProgress)
    if session.description_of(node_id) is None:
        reading = back_up_by_names(node, session.dictionary_of(node_id), domains=domains)
        return await shown(session, screen, label, reading, WalkProgress, ObjectRead)
    return await shown(session, screen, label, back_up(node, domains=domains), ObjectRead)


async def shown(
    session: BusSession,
    screen: Screen,
    label: str,
    procedure: Procedure[T],
    *kinds: type[Event],
    columns: Sequence[type[ProgressColumn]] = (MofNCompleteColumn, TimeRemainingColumn),
) -> T:
    """Run a procedure, with a bar on a terminal. kinds: its progress events, which have `done` and `total`, and perhaps a `step`.
    columns: behind the bar. label: before the bar."""
    if not screen.draws:
        return await session.master.run(procedure)
    async with beside(trio.open_nursery()) as nursery:
        with session.master.events(*kinds) as news:
            nursery.start_soon(_draw, screen, label, news, columns)
            result = await session.master.run(procedure)
    return result


async def _draw(screen: Screen, label: str, news: Subscription[Any], kinds: Sequence[type[ProgressColumn]]) -> None:
    columns = (TextColumn("{task.description}"), BarColumn(30), *(kind() for kind in kinds))
    with Progress(*columns, console=screen.err, transient=True, auto_refresh=False, get_time=trio.current_time) as progress:
        task = progress.add_task(escape(label), total=None)
        while True:
            for each in news.take()[-1:]:
                step = getattr(each, "step", None)
                description = escape(label if step is None else f"{label}: {step}")
                progress.update(task, completed=each.done, total=each.total, description=description)
            progress.refresh()
            await trio.sleep(REDRAW)


# ---- readings, for people and programs ----


def tell_unread(screen: Screen, backup: Backup, lost: Sequence[Reading] = ()) -> None:
    """List the missing objects, and with -v everything that was not read. lost: readings that a file could not hold exactly."""
    if backup.others_doing:
        screen.say(
            f"[yellow]another SDO client used the channel of node {backup.node_id} meanwhile: it {backup.others_doing}.[/] "
            "What was read is of the device, but the other may have changed it. End the other program, and read again."
        )
    for each in lost:
        data = (each.data or b"")[:16].hex(" ")
        screen.say(
            f"[yellow]not exact in the file:[/] {escape(f'{place_text(each.variable)} {each.variable.name}: bytes {data}')}"
        )
    missing = [each for each in backup.readings if each.result.is_missing]
    for each in missing[:MAX_LISTED]:
        screen.say(f"[yellow]not read:[/] {escape(reason_text(each))}")
    if len(missing) > MAX_LISTED:
        screen.say(f"[yellow]not read:[/] {len(missing) - MAX_LISTED} more; -v shows them")
    others = [each for each in backup.readings if each.result is not ReadResult.READ and not each.result.is_missing]
    for each in [*missing[MAX_LISTED:], *others]:
        screen.detail(f"not read: {reason_text(each)}")


def reason_text(reading: Reading) -> str:
    """Return why an object has no value."""
    why = RESULT_WORDS.get(reading.result, str(reading.result))
    if reading.result is ReadResult.WRONG_LENGTH and reading.data is not None:
        why = f"{len(reading.data)} bytes ({reading.data[:16].hex(' ')}) are no {reading.variable.data_type.name}"
    elif reading.abort_code is not None and reading.result.is_missing:
        why = f"{reading.result}: abort 0x{reading.abort_code:08X}, {text_of(reading.abort_code)}"
    return f"{place_text(reading.variable)} {reading.variable.name}: {why}"


def reading_as_json(reading: Reading) -> dict[str, Any]:
    """Return one object, for --json and for files."""
    variable = reading.variable
    return object_json(variable) | {
        "type": variable.data_type.name,
        "access": str(variable.access),
        "result": str(reading.result),
        "value": None if reading.value is None else as_json(variable, reading.value),
        "hex": (hex_text(variable, reading.value) if reading.value is not None else "") or None,
        "abort": reading.abort_code,
    }


def both_notations(variable: Variable, value: Value | None) -> str:
    """Return a text such as "517 (0x00000205)"; "?" if the value is not known."""
    if value is None:
        return "?"
    number = hex_text(variable, value)
    return f"{value_text(variable, value)} ({number})" if number else value_text(variable, value)


def check_indices(indices: tuple[range, ...] | None, files: tuple[str, ...]) -> None:
    """Raise a CommandError for a walk together with a file: a walk does not use it."""
    if indices is not None and files:
        raise usage("CO001", "--walk is for a device without a file, and -e names one", tries=("one of the two",))
