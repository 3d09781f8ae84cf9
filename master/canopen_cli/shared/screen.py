"""The output of a command: data to stdout, messages and progress to stderr, both with colour on a terminal only.

Foreign strings pass `escape` (or `clean`) on their way here. The consoles let no control character through in any case.

A Screen is made once per command, from the common options. `--json` makes data JSON, and errors too; `--quiet` leaves only data
and errors. With `--json` stderr is one document: the error, with the messages before it in `notes`. See `Screen.say`. Progress (a
picture that is drawn again and again) is shown on a terminal only; elsewhere it becomes plain lines.
"""

from __future__ import annotations

import errno
import os
import select
import sys
import textwrap
import traceback
from collections.abc import Iterable, Sequence
from typing import IO, Any, Final

from rich import box, markup
from rich.console import Console, RenderableType
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from canopen_cli.shared.marks import put_marks
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_master.plain_text import clean, clean_lines, json_text
from canopen_proto.explained import counted as counted

WIDTH_OFF_TERMINAL: Final = 200
"""Columns of a table in a file or a pipe. No table of ours is wider, so nothing is cut."""

NAME_WIDTH: Final = 18
"""Characters for the name of a fact, with the gap after it."""

GAP: Final = 2
"""Characters between two columns of a table."""


def escape(text: str) -> str:
    """Make a foreign string (of a device, a file, a driver, the user) fit for markup: clean, and without markup of its own."""
    return markup.escape(clean(text))


def node_text(node_id: int) -> str:
    """Return the text for a node, in both notations: 10 and 0x10 are two nodes."""
    return f"node {node_id} (0x{node_id:02X})"


class Screen:
    """The screen of a command. out, err: rich consoles. verbosity: -1 quiet, 0, 1 (-v), 2 (-vv). notes: with --json, the messages
    that wait for the end of the command."""

    def __init__(
        self, *, json_output: bool = False, verbosity: int = 0, color: bool = True, notes: list[str] | None = None
    ) -> None:
        self.json_output = json_output
        self.verbosity = verbosity
        self.notes = notes if notes is not None else []
        self._tells_at_once = False
        color = color and not os.environ.get("NO_COLOR")
        self.out = _console(sys.stdout, color)
        self.err = _console(sys.stderr, color)

    @property
    def draws(self) -> bool:
        """Whether progress is drawn: stderr is a terminal, and --quiet was not given."""
        return self.err.is_terminal and not self.err.is_dumb_terminal and self.verbosity >= 0

    # ---- data ----

    def data(self, renderable: RenderableType) -> None:
        """Print a result to stdout."""
        self.out.print(renderable)

    def fact(self, name: str, text: str) -> None:
        """Print a named result to stdout. A long text continues on the next line, aligned. With --json it is a message: the
        result is a document."""
        if self.json_output:
            self._note(f"{name}: {clean(text)}".lstrip(": "))
            return
        lines = textwrap.wrap(clean(text), max(self.out.width - NAME_WIDTH, NAME_WIDTH), break_on_hyphens=False) or [""]
        head = [name, *[""] * (len(lines) - 1)]
        for label, line in zip(head, lines, strict=True):
            self.out.print(f"[dim]{label:<{NAME_WIDTH}}[/]{markup.escape(line)}", soft_wrap=True)

    def json(self, value: Any) -> None:
        """Print a result to stdout as one JSON document."""
        self.out.out(json_text(value, None if isinstance(value, str) else 2))

    def text(self, text: str) -> None:
        """Print a whole file to stdout, its lines as they are."""
        self.out.out(clean_lines(text).rstrip("\n"), highlight=False)

    def table(self, columns: Sequence[str], rows: Iterable[Sequence[RenderableType]], *, right: Iterable[str] = ()) -> None:
        """Print a table to stdout; if it is too wide, one block for each row. right: the columns to align at the right."""
        rows = [tuple(row) for row in rows]
        table = plain_table(columns, rows, right=right)
        if self._fit(table, [list(column) for column in zip(columns, *rows, strict=True)]):
            self.out.print(table)
            return
        for number, row in enumerate(rows):
            block = Table.grid(padding=(0, 2))
            block.add_column(no_wrap=True)
            block.add_column(overflow="fold")
            for name, cell in zip(columns, row, strict=True):
                if cell != "":
                    block.add_row(" ".join(name.split()), cell)
            if number:
                self.out.print()
            self.out.print(block)

    def _fit(self, table: Table, columns: Sequence[Sequence[RenderableType]]) -> bool:
        """Set widths of the columns so that no word is broken. Return False if that is impossible."""
        wide = self.out.options.update(max_width=10_000)
        sizes = []
        for column, (_, *cells) in zip(table.columns, columns, strict=True):
            measures = [Measurement.get(self.out, wide, cell) for cell in (column.header, *cells)]
            least = max(1, *(each.maximum if column.no_wrap else each.minimum for each in measures))
            sizes.append((least, max(each.maximum for each in measures)))
        spare = self.out.width - GAP * (len(sizes) - 1) - sum(least for least, _ in sizes)
        if spare < 0:
            return False
        wishes = sorted(zip(sizes, table.columns, strict=True), key=lambda each: each[0][1] - each[0][0])
        for number, ((least, most), column) in enumerate(wishes):
            extra = min(most - least, spare // (len(wishes) - number))
            column.width = least + extra
            spare -= extra
        return True

    def check_reader(self) -> None:
        """Raise BrokenPipeError if the reader of stdout has gone, so that a long command need not go on.

        Does nothing on a system that cannot tell without writing (Windows).
        """
        try:
            stdout = sys.stdout.fileno()
        except (OSError, ValueError):
            return  # not a file: a test, a notebook
        if hasattr(select, "poll"):
            poll = select.poll()
            poll.register(stdout, 0)
            if any(signs & select.POLLERR for _, signs in poll.poll(0)):
                raise BrokenPipeError(errno.EPIPE, "the reader of the output has gone")

    # ---- messages ----

    def say(self, text: str) -> None:
        """Print a message, unless --quiet. Markup is interpreted.

        With --json it waits, so that an error stands alone on stderr: it comes in the `notes` of that error, or of `finish`. Only
        after `tell_at_once` it is a document in a line, {"note": ...}, at once.
        """
        if self.verbosity >= 0:
            self.warn(text)

    def warn(self, text: str) -> None:
        """Print a message as `say` does, with --quiet too."""
        if self.json_output:
            self._note(Text.from_markup(text).plain.strip())
        else:
            self.err.print(text, highlight=False, soft_wrap=not self.err.is_terminal)

    def tell_at_once(self) -> None:
        """With --json let no message wait from now on: for a command that runs until Ctrl-C."""
        self._tells_at_once = True
        waiting = self.notes.copy()
        self.notes.clear()
        for each in waiting:
            self._note(each)

    def finish(self) -> None:
        """Print the messages that wait, as one document: for a command that ends without an error."""
        if self.notes:
            self.err.out(json_text({"notes": self.notes}), highlight=False)

    def _note(self, text: str) -> None:
        if text and self._tells_at_once:
            self.err.out(json_text({"note": text}), highlight=False)
        elif text:
            self.notes.append(text)

    def ask(self, text: str) -> None:
        """Print a question; the answer stands behind it, on the same line. Markup is interpreted."""
        self.err.print(text, highlight=False, soft_wrap=True, end="")
        self.err.file.flush()

    def detail(self, text: str) -> None:
        """Print a message, only with -v."""
        if self.verbosity >= 1 and self.json_output:
            self._note(clean(text).strip())
        elif self.verbosity >= 1:
            self.err.print(Text(clean(text), style="dim"), soft_wrap=True)

    def problem(self, problem: CommandError) -> None:
        """Show an error; with -vv also the traceback."""
        trace = ""
        if self.verbosity >= 2 and problem.__cause__ is not None:
            trace = "".join(traceback.format_exception(problem.__cause__)).rstrip()
        if self.json_output:
            more = {"traceback": trace.splitlines()} if trace else {}
            self.err.out(json_text({**problem.as_json(), "notes": self.notes, **more}), highlight=False)
            return
        if trace:
            self.err.out(trace, highlight=False)
        interrupted = problem.exit_code is ExitCode.INTERRUPTED
        failed = problem.failed.removeprefix("interrupted ") if interrupted else problem.failed
        head = "[bold yellow]interrupted[/]" if interrupted else f"[bold red]error {problem.code}:[/]"
        if not self.err.is_terminal:
            self.err.print(f"{head} {escape(failed)}", highlight=False, soft_wrap=True)
            for label, text in problem.details():
                self.err.print(f"  {label} {escape(text)}", highlight=False, soft_wrap=True)
            return
        self.err.print(f"{head} {escape(failed)}", highlight=False)
        grid = Table.grid(padding=(0, 1))
        grid.add_column(style="dim", no_wrap=True)
        grid.add_column()
        for label, text in problem.details():
            style = "bold cyan" if label.startswith(("try", "or")) else ""
            grid.add_row(f"  {label}", Text(clean(text), style=style))
        self.err.print(grid)


def plain_table(columns: Sequence[str], rows: Iterable[Sequence[RenderableType]], *, right: Iterable[str] = ()) -> Table:
    """Make a table with the look of all our tables: no frame, a rule below the heads."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True, header_style="bold", show_edge=False)
    numbers = frozenset(right)
    for name in columns:
        table.add_column(name, justify="right" if name in numbers else "left", no_wrap=name in numbers)
    for row in rows:
        table.add_row(*row)
    return table


class _Console(Console):
    """A console that raises BrokenPipeError on a closed pipe. rich raises SystemExit, which trio would wrap in a group."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError

    def _render_buffer(self, buffer: Iterable[Segment]) -> str:
        """Show control characters instead of obeying them. Control codes of rich's own are separate segments."""
        return super()._render_buffer(each if each.control else each._replace(text=clean_lines(each.text)) for each in buffer)


def _console(stream: IO[str], color: bool) -> Console:
    put_marks(stream)
    console = _Console(file=stream, no_color=not color, highlight=False, emoji=False)
    if not console.is_terminal:
        columns = os.environ.get("COLUMNS", "")
        console.width = (int(columns) if columns.isdecimal() else 0) or WIDTH_OFF_TERMINAL
    return console
