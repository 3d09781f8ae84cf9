"""Progress while a recording is read, with the time left: on a terminal, once it takes longer than PATIENCE."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from time import monotonic
from typing import TYPE_CHECKING, Final

from canopen_cli.shared.screen import Screen, escape
from canopen_transports.log_files import LogReader
from canopen_transports.record import Record

if TYPE_CHECKING:
    from rich.progress import Progress

PATIENCE: Final = 1.0
"""Seconds before anything is drawn; and after a line, where lines and the bar share a terminal."""
REDRAW: Final = 0.2
LOOK_EACH: Final = 64
"""Records between two looks at the clock."""


class FileReading:
    """The records of a file, and a bar that shows how far it is read. Iterate over it once.

    The bar is on stderr. Lines on stdout may have the same terminal: `clear` takes the bar away before a line is written.
    """

    def __init__(self, screen: Screen, reader: LogReader, records: Iterable[Record], *, look_each: int = LOOK_EACH) -> None:
        """records: those of the reader, perhaps not all. look_each: 1 for records that come as slowly as they were recorded."""
        self._screen = screen
        self._reader = reader
        self._records = records
        self._look_each = look_each
        self._bar: Progress | None = None
        self._due = 0.0

    def __iter__(self) -> Generator[Record]:
        if not self._screen.draws:
            yield from self._records
            return
        self._due = monotonic() + PATIENCE
        try:
            for number, record in enumerate(self._records, 1):
                if number % self._look_each == 0 and monotonic() >= self._due:
                    self._draw()
                yield record
        finally:
            self._take_away()

    def clear(self) -> None:
        """Take the bar away, if stdout is a terminal: a line comes. It is drawn again once PATIENCE is over without one."""
        if self._screen.draws and self._screen.out.is_terminal:
            self._take_away()
            self._due = monotonic() + PATIENCE

    def _draw(self) -> None:
        self._due = monotonic() + REDRAW
        if _is_a_pagers(self._screen):
            self._take_away()
            return
        if self._bar is None:
            self._bar = self._made()
        self._bar.start()
        self._bar.update(self._bar.task_ids[0], completed=self._reader.share or 0.0)
        self._bar.refresh()

    def _made(self) -> Progress:
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn  # a terminal's alone

        label = TextColumn(f"reading {escape(str(self._reader.path))}")
        columns = (label, BarColumn(30), TaskProgressColumn(), TimeRemainingColumn())
        bar = Progress(
            *columns,
            console=self._screen.err,
            transient=True,
            auto_refresh=False,
            redirect_stdout=False,  # it would take lines to where the bar is
            redirect_stderr=False,
        )
        bar.add_task("", total=1.0)
        return bar

    def _take_away(self) -> None:
        if self._bar is not None and self._bar.live.is_started:
            self._bar.stop()


def watched(screen: Screen, reader: LogReader, records: Iterable[Record]) -> Iterator[Record]:
    """Yield the records of a file, and show how far it is, where nothing is printed meanwhile."""
    return iter(FileReading(screen, reader, records))


def _is_a_pagers(screen: Screen) -> bool:
    """Return whether another program has the terminal for itself: a pager, which reads single keys from it."""
    try:
        import termios
    except ImportError:  # Windows
        return False
    try:
        modes: int = termios.tcgetattr(screen.err.file.fileno())[3]
    except (termios.error, OSError, ValueError):  # no terminal of the system: a test, a notebook
        return False
    return not modes & termios.ICANON
