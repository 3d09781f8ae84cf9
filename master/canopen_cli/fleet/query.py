"""`canopen fleet query`: SQL over what `canopen fleet record` has written, and simple questions without it."""

from __future__ import annotations

import csv
import io
import itertools
import re
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Final, NamedTuple

import click

from canopen_cli.shared.options import Kind, Settings, TextKind, command
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_gateway.fleet.keys import ANY, NAME, FleetPlace, parse_place
from canopen_gateway.history import History, HistoryTable, open_history
from canopen_gateway.history.query import VIEWS
from canopen_master.plain_text import clean

MOST_ROWS: Final = 1000
_CHOICE: Final = (
    "SELECT time, place, object, name, integer, real, text, unit, raw, problem FROM samples WHERE {} ORDER BY time, place, name"
)
_AGO: Final = re.compile(r"([0-9]+(?:\.[0-9]+)?) ?(s|min|h|d)(?: ago)?")
_UNITS: Final = {"s": "seconds", "min": "minutes", "h": "hours", "d": "days"}
_COLUMNS: Final = ("time", "place", "object", "name", "value", "unit", "raw", "problem")


class PastObject(NamedTuple):
    """What was recorded of a node: an object, or all of it (None)."""

    place: FleetPlace
    key: str | None


class PastObjectText(TextKind):
    """SITE/NODE, of any bus, or SITE/BUS/NODE, perhaps with an object of it: "hall-2/5:statusword"; * stands for each."""

    name = "object"

    def read(self, text: str) -> PastObject:
        place, colon, key = text.partition(":")
        words = place.split("/")
        if len(words) == 2:
            words.insert(1, ANY)
        if colon and not key:
            raise ValueError(f"{text!r} names no object behind its colon")
        return PastObject(parse_place("/".join(words), node=True), key or None)


class PastTime(Kind):
    """A time by the recorder's clock: "2h" ago, or "2026-11-28T22:00" (of this computer's zone, if it names none)."""

    name = "moment"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> datetime:
        if isinstance(value, datetime):
            return value
        text = str(value).strip()
        try:
            if "-" in text:
                return datetime.fromisoformat(text).astimezone()
            if (ago := _AGO.fullmatch(text)) is None:
                raise ValueError(text)
            return datetime.now().astimezone() - timedelta(**{_UNITS[ago[2]]: float(ago[1])})
        except (ValueError, OSError, OverflowError):
            self.fail(f"{value!r} is neither a time ago (90s, 30min, 2h, 7d) nor one by the clock (2026-11-28T22:00)", param, ctx)


@command()
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path), metavar="DIR")
@click.argument("wanted", type=PastObjectText(), nargs=-1, metavar="[NODE:OBJECT]...")
@click.option("--sql", default="", metavar="SELECT", help="A SELECT of the views, or the name of one of them: gaps.")
@click.option("--since", type=PastTime(), help="Only from then on, by the recorder's clock: 2h ago, or 2026-11-28T22:00.")
@click.option("--until", type=PastTime(), help="Only until then.")
@click.option("--limit", type=click.IntRange(0), default=MOST_ROWS, show_default=True, help="Rows that are shown; 0: all.")
@click.option("--csv", "as_csv", is_flag=True, help="As CSV.")
def query(
    settings: Settings,
    screen: Screen,
    folder: Path,
    wanted: tuple[PastObject, ...],
    sql: str,
    since: datetime | None,
    until: datetime | None,
    limit: int,
    as_csv: bool,
) -> None:
    """Ask what a fleet was: a list of what was recorded, values of nodes and objects, or SQL. Needs the extra `history`.

    NODE is SITE/NODE or SITE/BUS/NODE; * stands for each. OBJECT is a name, or 6041:00; without one, all of the node. SQL is one
    SELECT of the views samples, states, emergencies, gaps, nodes and runs, or the name of one of them. It reads nothing else, and
    changes nothing. Exit status 6: a file of the folder cannot be read; 2: the SQL is wrong.

    \b
    canopen fleet query history
    canopen fleet query history hall-2/5:statusword --since 2h
    canopen fleet query history --sql gaps
    canopen fleet query history --sql "SELECT place, max(value) FROM samples WHERE name LIKE '%torque%' GROUP BY place" --csv
    """
    if as_csv and settings.json:
        raise usage("CO123", "--csv and --json are two forms", tries=("one of them",))
    if sql and any(each.key for each in wanted):
        raise usage("CO123", "an object is for questions without SQL", tries=("WHERE name = '...'",))
    with open_history(folder, places=[each.place for each in wanted], since=since, until=until) as history:
        table = _asked(history, sql, wanted)
        more = _show(settings, screen, table, history, limit, as_csv)
    if history.foreign:
        what = counted(len(history.foreign), "file")
        screen.warn(f"{what} in the folder of no recorder, left alone: {escape(str(history.foreign[0]))}")
    if more:
        screen.warn(f"the first {counted(limit, 'row')}; there are more: --limit 0 shows all")


def _asked(history: History, sql: str, wanted: Sequence[PastObject]) -> HistoryTable:
    word = sql.strip().lower()
    if word in VIEWS:
        return history.ask(f"SELECT * FROM {word} ORDER BY ALL")
    if word:
        return history.ask(sql)
    if not wanted:
        return history.ask("SELECT * FROM nodes ORDER BY place")
    values = list[Any]()
    table = history.ask(_CHOICE.format(" OR ".join(_condition(each, values) for each in wanted)), values)
    types = dict(zip(table.columns, table.types, strict=True)) | {"value": "as its type has it"}
    return HistoryTable(_COLUMNS, [types[each] for each in _COLUMNS], map(_with_one_value, table.rows))


def _condition(wanted: PastObject, values: list[Any]) -> str:
    """Return the condition for what is wanted. values: those for its ?."""
    said, place, key = ["true"], *wanted
    for column, word in (("site", place.site), ("bus", place.bus)):
        if word != ANY:
            assert NAME.match(word)
            said.append(f"{column} = ?")
            values.append(word)
    if place.node_id > 0:
        said.append("node = ?")
        values.append(place.node_id)
    if key is not None:
        said.append("(name = ? OR object = ? OR object = upper(?) || ':00')")
        values += [key, _place_text(key), key]
    return "(" + " AND ".join(said) + ")"


def _place_text(text: str) -> str:
    """Return "6041:00" as it is recorded, whatever its case."""
    return text.upper() if ":" in text and len(text) == 7 else text


def _with_one_value(row: Sequence[Any]) -> tuple[Any, ...]:
    time, place, key, name, integer, real, text, unit, raw, problem = row
    value = next((each for each in (integer, real, text) if each is not None), None)
    return time, place, key, name, value, unit, raw, problem


def _show(settings: Settings, screen: Screen, table: HistoryTable, history: History, limit: int, as_csv: bool) -> bool:
    """Show a table; return whether rows were left off."""
    rows = table.rows if not limit else itertools.islice(table.rows, limit)
    if as_csv:
        screen.text(_csv_line(table.columns))
        for row in rows:
            screen.text(_csv_line(row))
    elif settings.json:
        shown = [list(row) for row in rows]
        more = bool(limit) and next(table.rows, None) is not None
        screen.json(
            {
                "columns": list(table.columns),
                "types": list(table.types),
                "rows": shown,
                "more": more,
                "files": len(history.files),
                "foreign": len(history.foreign),
            }
        )
        return more
    else:
        shown_rows = [tuple("" if cell is None else escape(clean(str(cell))) for cell in row) for row in rows]
        screen.table([escape(each) for each in table.columns], shown_rows)
        screen.say(counted(len(shown_rows), "row"))
    return bool(limit) and next(table.rows, None) is not None


def _csv_line(row: Sequence[Any]) -> str:
    text = io.StringIO()
    cells = ["" if cell is None else clean(cell) if isinstance(cell, str) else cell for cell in row]
    csv.writer(text, lineterminator="").writerow(cells)
    return text.getvalue()
