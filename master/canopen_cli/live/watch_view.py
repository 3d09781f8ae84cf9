"""The picture of `canopen watch`: a table of values, with curves below it if they are wanted. Pure: text of a given size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from rich.cells import cell_len
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from canopen_cli.live.braille import curve
from canopen_cli.live.watched import View, WatchedRow, state_style
from canopen_cli.shared.screen import counted, node_text
from canopen_master.plain_text import clean
from canopen_proto.machine import SECOND, Time

LEAST_NAME: Final = 10
MOST_VALUE: Final = 28
LEAST_CURVE: Final = 3
"""Lines of a curve that tells something."""
MOST_CURVE: Final = 8
JOINED: Final = 1.0
"""Seconds between two points that are joined: a value without a newer one is stale after that time."""
SCALE: Final = 12
"""Characters for the values beside a curve."""
GAP: Final = 1
COLUMNS: Final = ("object", "name", "value", "unit", "min", "max", "age", "from")
INDENT: Final = "        "


class Around(NamedTuple):
    """The lines around the table. where: the bus or file; how: where values come from, and the load that this makes; keys: what
    the keys do; notes: what else has happened, each in one line; paused: seconds for which the picture stands still; None: it
    goes on.
    """

    where: str
    how: str = ""
    keys: str = ""
    notes: tuple[str, ...] = ()
    paused: float | None = None


def picture(view: View, around: Around, width: int, height: int, *, span: float = 0.0) -> RenderableType:
    """Return the whole picture. width, height: of the terminal; what does not fit is counted. span: seconds of the curves; 0:
    none."""
    head = [_head(view, around, width)]
    foot = [line(note, width, "yellow") for note in around.notes]
    foot += [line(each, width, "dim") for each in (around.how, around.keys) if each]
    if view.emergency:
        assert view.emergency_age is not None
        foot.insert(0, line(f"last EMCY, {age_text(view.emergency_age)} ago: {view.emergency}", width, "red"))
    room = height - len(head) - len(foot) - 1  # the heads of the columns
    blocks = [_below(row, width) for row in view.rows]
    shown, used = 0, 0
    while shown < len(blocks) and used + 1 + len(blocks[shown]) <= room:
        used += 1 + len(blocks[shown])
        shown += 1
    if shown < len(blocks):  # one line says so
        while shown and used >= room:
            shown -= 1
            used -= 1 + len(blocks[shown])
    body: list[RenderableType] = [*head, _table(view.rows, blocks, shown, width)]
    if shown < len(blocks):
        body.append(line(f"... {counted(len(blocks) - shown, 'object')} more: the terminal is too low", width, "yellow"))
        used += 1
    elif span:
        curves, lines = _curves(view.rows, width, room - used, span)
        body += curves
        used += lines
    body += [Text("")] * max(0, room - used)
    return Group(*body, *foot)


def plain(view: View, around: Around, width: int) -> RenderableType:
    """Return the table as it is printed once."""
    return picture(
        view, around._replace(keys=""), width, 3 + len(around.notes) + sum(2 + len(_below(row, width)) for row in view.rows)
    )


def age_text(age: Time) -> str:
    """Return a time that has passed, for people: "0.2 s", "12 s", "3 min", "2 h". age: ns."""
    seconds = age / SECOND
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"


def line(text: str, width: int, style: str = "") -> Text:
    """Return a line of foreign text, cut to the width."""
    made = Text(clean(text), style=style, no_wrap=True)
    made.truncate(max(1, width), overflow="ellipsis")
    return made


def _head(view: View, around: Around, width: int) -> Text:
    heard = "never heard" if view.heard is None else f"last heard {age_text(view.heard)} ago"
    state = view.state or "NMT state not known"
    left = f"{node_text(view.node_id)}  {state}  {heard}"
    right = around.where
    if around.paused is not None:
        right = f" PAUSED {around.paused:.0f} s AGO "
    gap = max(2, width - cell_len(left) - cell_len(clean(right)))
    text = line(f"{left}{' ' * gap}{right}", width)
    text.stylize("bold", 0, len(node_text(view.node_id)))
    if around.paused is not None:
        text.stylize("reverse", len(left) + gap)
    return text


def _cells(row: WatchedRow) -> tuple[str, ...]:
    age = "" if row.age is None else age_text(row.age)
    value = row.value or "-"
    return row.place, row.name, value, row.unit, row.least, row.most, age, row.source


def _table(rows: Sequence[WatchedRow], blocks: Sequence[Sequence[Text]], shown: int, width: int) -> RenderableType:
    cells = [tuple(map(clean, _cells(row))) for row in rows[:shown]]
    used = [name in COLUMNS[:3] or any(each[place] for each in cells) for place, name in enumerate(COLUMNS)]
    sizes = [max(map(cell_len, (name, *(each[place] for each in cells)))) for place, name in enumerate(COLUMNS)]
    sizes[2] = min(sizes[2], MOST_VALUE)
    others = sum(size + GAP for place, size in enumerate(sizes) if used[place] and place != 1)
    sizes[1] = max(LEAST_NAME, min(sizes[1], width - others))
    table = Table.grid(padding=(0, GAP, 0, 0))
    right = ("value", "min", "max", "age")
    for place, name in enumerate(COLUMNS):
        if used[place]:
            table.add_column(width=sizes[place], no_wrap=True, overflow="ellipsis", justify="right" if name in right else "left")
    table.add_row(*(Text(name, style="bold") for place, name in enumerate(COLUMNS) if used[place]))
    pieces: list[RenderableType] = []
    for row, each, block in zip(rows, cells, blocks, strict=False):
        styles = _styles(row)
        table.add_row(*(Text(cell, style=styles[place]) for place, cell in enumerate(each) if used[place]))
        if block:
            pieces += [table, *block]
            table = _same_columns(table)
    return Group(*pieces, table) if pieces else table


def _same_columns(table: Table) -> Table:
    fresh = Table.grid(padding=(0, GAP, 0, 0))
    for column in table.columns:
        fresh.add_column(width=column.width, no_wrap=True, overflow="ellipsis", justify=column.justify)
    return fresh


def _styles(row: WatchedRow) -> tuple[str, ...]:
    value = "dim" if row.is_stale else "bold"
    age = "bold yellow" if row.is_stale else "dim"
    return ("dim" if row.is_stale else "", "dim" if row.is_stale else "", value, value, "dim", "dim", age, "dim")


def _below(row: WatchedRow, width: int) -> list[Text]:
    """Return the lines below the row of an object: words and bits, and what is the matter with it."""
    lines = []
    if row.is_stale:
        why = row.trouble or "nothing has brought it again"
        lines.append(line(f"{INDENT}STALE: {why}", width, "yellow"))
    elif row.trouble:
        lines.append(line(f"{INDENT}{row.trouble}", width, "yellow"))
    if row.bits:
        text = line(f"{INDENT}{row.words[0]}  {row.bits}", width, "dim" if row.is_stale else "")
        text.stylize(f"bold {state_style(row)}" if not row.is_stale else "dim", len(INDENT), len(INDENT) + len(row.words[0]))
        lines.append(text)
        if row.words[1:]:
            lines.append(line(f"{INDENT}{', '.join(row.words[1:])}", width, "dim" if row.is_stale else ""))
    elif row.words:
        lines.append(line(f"{INDENT}{', '.join(row.words)}", width, "dim" if row.is_stale else ""))
    return lines


def _curves(rows: Sequence[WatchedRow], width: int, room: int, span: float) -> tuple[list[RenderableType], int]:
    """Return the curves that fit, and how many lines they have."""
    numbers = [row for row in rows if row.curve or row.number is not None]
    if not numbers:
        return [], 0
    size = min(MOST_CURVE, room // len(numbers) - 1)
    while numbers and size < LEAST_CURVE:
        numbers.pop()
        size = min(MOST_CURVE, room // len(numbers) - 1) if numbers else 0
    pieces: list[RenderableType] = []
    for row in numbers:
        pieces.append(line(f"{row.name}{f' in {row.unit}' if row.unit else ''}, the last {span:g} s", width, "bold"))
        points = ((1 - slot.age / SECOND / span, slot.least, slot.most) for slot in row.curve)
        lines, least, most = curve(points, max(1, width - SCALE - 1), size, JOINED / span)
        labels = [""] * size
        labels[-1], labels[0] = f"{least:.6g}", f"{most:.6g}" if most > least else ""
        if most == least:
            labels[-1], labels[(size - 1) // 2] = "", labels[-1]
        pieces += [
            Text.assemble((f"{label:>{SCALE}}", "dim"), " ", (text, "dim" if row.is_stale else "cyan"))
            for label, text in zip(labels, lines, strict=True)
        ]
    return pieces, len(numbers) * (size + 1)
