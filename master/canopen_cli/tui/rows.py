"""`Rows`: a table of the view, whose rows change in place; and the pieces of text in it.

Each cell is a text of its own: strings of devices are shown, and never taken for markup. Some columns share what the others
leave, so that a table is as wide as its terminal.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, Final, NamedTuple

from rich.text import Text
from textual import events
from textual.binding import BindingType
from textual.widgets import DataTable

from canopen_master.plain_text import clean

GAP: Final = 2
"""Cells of a column beside its text: one on each side."""
LEAST: Final = 8
"""Cells of a column that takes a share of what the others leave."""
MOST_CELL: Final = 400
"""Characters of one cell."""


class RowsColumn(NamedTuple):
    """A column. width: in cells; 0: its share of what the others leave. right: numbers. wide_only: the least
    width of a table that has it."""

    title: str
    width: int
    right: bool = False
    wide_only: int = 0


def cell(text: str, style: str = "") -> Text:
    """Return a text for a cell, without what a terminal would obey."""
    return Text(clean(text, MOST_CELL), style=style, no_wrap=True, overflow="ellipsis")


class Rows(DataTable[Text]):
    """See this module's text."""

    BINDINGS: ClassVar[list[BindingType]] = []

    def __init__(self, columns: Sequence[RowsColumn], *, id: str) -> None:
        super().__init__(id=id, cursor_type="row", cell_padding=1, header_height=1)
        self._all = tuple(columns)
        self._given: list[tuple[Any, tuple[Text, ...]]] = []
        self._places: list[int] = []
        self._shown: list[tuple[Any, tuple[Text, ...]]] = []
        self._width = 0

    @property
    def chosen(self) -> Any:
        """What the row at the cursor is about; None if there is no row."""
        return self._shown[self.cursor_row][0] if 0 <= self.cursor_row < len(self._shown) else None

    def fill(self, rows: Iterable[tuple[Any, Sequence[Text]]]) -> None:
        """Show these rows, each with what it is about. The cursor stays at its row, if that is still there."""
        self._given = [(key, tuple(cells)) for key, cells in rows]
        self._show()

    def on_resize(self, event: events.Resize) -> None:
        """Give the columns the widths that fit."""
        self._lay_out(event.size.width)

    def _lay_out(self, width: int) -> None:
        if width == self._width or not width:
            return
        self._width = width
        self._places = [place for place, each in enumerate(self._all) if width >= each.wide_only]
        columns = [self._all[place] for place in self._places]
        fixed = sum(each.width for each in columns) + GAP * len(columns)
        sharing = sum(not each.width for each in columns)
        share = max(LEAST, (width - fixed - 1) // max(1, sharing))  # 1: the bar at the side
        row = self.cursor_row
        self.clear(columns=True)
        for number, each in enumerate(columns):
            title = Text(each.title, justify="right" if each.right else "left")
            self.add_column(title, width=each.width or share, key=str(number))
        self._shown = []
        self._show()
        if self._shown:
            self.move_cursor(row=min(row, len(self._shown) - 1))

    def _show(self) -> None:
        if not self._width:
            return
        rows = [(key, tuple(self._aligned(cells, place) for place in self._places)) for key, cells in self._given]
        if [key for key, _ in rows] != [key for key, _ in self._shown]:
            at = self.chosen
            top = self.scroll_y
            self.clear()
            for key, cells in rows:
                self.add_row(*cells, key=str(key))
            keys = [key for key, _ in rows]
            if at in keys:
                self.move_cursor(row=keys.index(at), scroll=False)
                self.scroll_to(y=top, animate=False, immediate=True)
        else:
            for (key, cells), (_, before) in zip(rows, self._shown, strict=True):
                for number, (each, was) in enumerate(zip(cells, before, strict=True)):
                    if each != was:
                        self.update_cell(str(key), str(number), each)
        self._shown = rows

    def _aligned(self, cells: Sequence[Text], place: int) -> Text:
        text = cells[place]
        if self._all[place].right:
            text.justify = "right"
        return text
