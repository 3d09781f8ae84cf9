"""`canopen shell`: a Python prompt on an open bus, with `await`, completion and history.

The statements run in the command's loop, so that the bus goes on. The prompt waits in a thread, where prompt_toolkit has a loop
of its own. Without a terminal, the statements are what stdin has; the first that fails ends them.
"""

from __future__ import annotations

import ast
import contextlib
import os
import signal
import sys
from collections.abc import AsyncIterator, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import click
import trio

from canopen_cli.scripting.namespace import execute, failure_of, line_compiler, names_for
from canopen_cli.scripting.text_plot import TextPlot, statement_of
from canopen_cli.scripting.words import words_for
from canopen_cli.shared.options import NodeId, Settings, command, enabling
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.questions import read_input
from canopen_cli.shared.running import first_of, run
from canopen_cli.shared.screen import Screen, escape, node_text
from canopen_cli.shared.session import open_session
from canopen_data import ENVIRONMENT_VARIABLE
from canopen_master.node import Node

if TYPE_CHECKING:
    from prompt_toolkit import PromptSession
    from prompt_toolkit.completion import Completer, Completion
    from prompt_toolkit.document import Document

NAME: Final = "<shell>"
MORE: Final = "... "
PROMPT: Final = ">>> "
HISTORY: Final = "shell_history"


class Lines(Protocol):
    """Where the lines of a prompt come from."""

    async def next(self, prompt: str) -> str | None:
        """Wait for a line; None at the end of the input. Raises KeyboardInterrupt for a Ctrl-C in a line."""


@command("shell")
@click.argument("node_id", metavar="[NODE]", type=NodeId(), required=False)
@enabling
def shell(settings: Settings, screen: Screen, node_id: int | None) -> None:
    """A Python prompt on an open bus, with `await`, completion of nodes, objects and constants, and history.

    It has `master`, `nodes` (`nodes[5]`), `node` (that of NODE), `bus` and `plot`. Ctrl-C ends a statement, Ctrl-D the prompt;
    both halt what it left moving. Without a terminal it reads statements from stdin. At a terminal it needs prompt_toolkit: pip
    install 'canopen-proto[shell]'.

    \b
    canopen shell 3 -b demo
    >>> await node.read("statusword")
    >>> await nodes[4].write("profile_velocity", 20000)
    >>> plot 4:velocity_actual_value 10s
    echo 'await node.read("statusword")' | canopen shell 3 -b demo
    """
    lines = TerminalLines() if sys.stdin.isatty() and sys.stdout.isatty() else None

    async def work() -> None:
        async with open_session(settings, screen) as session:
            names = names_for(session, node_id)
            names["plot"] = TextPlot(screen, partial(_node_of, names)).plot
            prompt = Prompt(screen, names)
            if lines is None:
                await prompt.execute_all(await _input())
                return
            lines.complete_from(prompt.names)
            who = "" if node_id is None else f", node: {node_text(node_id)}"
            screen.say(f"[bold]{escape(session.bus)}[/]: master, nodes[5]{who}; Ctrl-D ends")
            await prompt.serve(lines)

    run(settings, screen, work)


def _node_of(names: dict[str, Any], text: str | None) -> Node:
    """Return a node for `plot`. text: None: that of the shell. Raises a CommandError."""
    if text is not None:
        node: Node = names["nodes"][text]
        return node
    if isinstance(names.get("node"), Node):
        return names["node"]  # type: ignore[no-any-return]
    raise usage("CO120", "this shell has no node of its own", tries=("plot 5:velocity_actual_value",))


async def _input() -> str:
    """Return what stdin has, to its end."""
    read = b""
    while more := await read_input():
        read += more
    return read.decode(errors="replace")


class Prompt:
    """Statements, one after the other, with the names that they share."""

    def __init__(self, screen: Screen, names: dict[str, Any]) -> None:
        self.names = names
        self._screen = screen
        self._compile = line_compiler()

    async def execute_all(self, text: str) -> None:
        """Execute statements, and show what each is worth. Raises a CommandError for the first that fails."""
        try:
            statements = ast.parse("\n".join(map(statement_of, text.split("\n"))), NAME).body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise failure_of(error, NAME) from error
        for each in statements:
            try:
                code = compile(ast.Interactive([each]), NAME, "single", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT, dont_inherit=True)
                failure = await self._execute(code)
            except (SyntaxError, ValueError) as error:
                raise failure_of(error, NAME) from error
            except SystemExit:
                return
            if failure is not None:
                raise failure

    async def serve(self, lines: Lines) -> None:
        """Read and execute statements until the input ends, or one of them ends it. Failures are shown."""
        begun: list[str] = []
        while True:
            try:
                line = await lines.next(MORE if begun else PROMPT)
            except KeyboardInterrupt:
                begun.clear()
                continue
            if line is None:
                return
            begun.append(line if begun else statement_of(line))
            try:
                code = self._compile("\n".join(begun), NAME, "single")
            except (SyntaxError, ValueError, OverflowError, MemoryError, RecursionError) as error:
                self._screen.problem(failure_of(error, NAME))
                begun.clear()
                continue
            if code is None:
                continue
            begun.clear()
            try:
                failure = await self._execute(code)
            except SystemExit:
                return
            if failure is not None:
                self._screen.problem(failure)

    async def _execute(self, code: Any) -> CommandError | None:
        """Run a statement, and show what it is worth. A Ctrl-C cancels it. Returns its failure. Raises SystemExit."""
        interrupted = False
        failure: CommandError | None = None
        hook, sys.displayhook = sys.displayhook, self._show
        try:
            async with _interrupts() as interrupts, trio.open_nursery() as nursery:

                async def cancel() -> None:
                    nonlocal interrupted
                    async for _ in interrupts:
                        interrupted = True
                        nursery.cancel_scope.cancel()

                nursery.start_soon(cancel)
                try:
                    await execute(code, self.names)
                except Exception as error:  # noqa: BLE001 - a user's statement: its failure is told, and the prompt goes on
                    failure = failure_of(first_of(error), NAME)
                nursery.cancel_scope.cancel()
        except BaseExceptionGroup as group:
            ended = first_of(group)
            if isinstance(ended, SystemExit):
                raise ended from None
            raise
        finally:
            sys.displayhook = hook
        if interrupted:
            self._screen.say("[yellow]interrupted[/]")
        return failure

    def _show(self, value: object) -> None:
        if value is None:
            return
        self.names["_"] = value
        try:
            text = repr(value)
        except Exception as error:  # noqa: BLE001 - of a user's class
            text = f"<{type(value).__name__}, whose repr fails: {type(error).__name__}>"
        self._screen.data(escape(text))


@contextlib.asynccontextmanager
async def _interrupts() -> AsyncIterator[AsyncIterator[int]]:
    with trio.open_signal_receiver(signal.SIGINT) as received:
        yield received


class TerminalLines:
    """The lines of a terminal, by prompt_toolkit: keys, completion, history. Raises CommandError if that is not installed."""

    def __init__(self, **options: Any) -> None:
        """options: of PromptSession."""
        try:
            from prompt_toolkit import PromptSession
            from prompt_toolkit.history import FileHistory, InMemoryHistory
        except ImportError as missing:
            raise CommandError(
                ExitCode.CANNOT_OPEN,
                "CO101",
                "the prompt needs prompt_toolkit, which is not installed",
                tries=("pip install 'canopen-proto[shell]'", "statements by a pipe: echo '...' | canopen shell"),
            ) from missing
        path = history_path()
        history = InMemoryHistory() if path is None else FileHistory(str(path))
        self._session: PromptSession[str] = PromptSession(history=history, **options)

    def complete_from(self, names: dict[str, Any]) -> None:
        """Complete words by these names from now on."""
        self._session.completer = _completer(names)

    async def next(self, prompt: str) -> str | None:
        """See Lines. If it is cancelled, the terminal is given back before."""
        ended: list[BaseException] = []
        lines: list[str] = []

        def ask() -> None:
            try:
                lines.append(self._session.prompt(prompt, handle_sigint=False))
            except (EOFError, KeyboardInterrupt) as error:
                ended.append(error)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._leave_when_cancelled)
            with trio.CancelScope(shield=True):  # `_leave_when_cancelled` ends it
                await trio.to_thread.run_sync(ask)
            nursery.cancel_scope.cancel()
        await trio.lowlevel.checkpoint_if_cancelled()
        if ended and isinstance(ended[0], KeyboardInterrupt):
            raise KeyboardInterrupt
        return None if ended else lines[0]

    async def _leave_when_cancelled(self) -> None:
        try:
            await trio.sleep_forever()
        finally:
            app = self._session.app
            if app.is_running and app.loop is not None:
                with contextlib.suppress(RuntimeError):  # it has just ended
                    app.loop.call_soon_threadsafe(self._leave)

    def _leave(self) -> None:
        if self._session.app.is_running:
            with contextlib.suppress(Exception):  # it ends already
                self._session.app.exit(exception=EOFError())


def history_path() -> Path | None:
    """Return the file of the history, in the folder of the user's own files; None if it cannot be written."""
    folder = Path(os.environ.get(ENVIRONMENT_VARIABLE) or Path.home() / ".canopen")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / HISTORY
        with path.open("ab"):
            return path
    except OSError:
        return None


def _completer(names: dict[str, Any]) -> Completer:
    from prompt_toolkit.completion import Completer, Completion

    class OfNames(Completer):
        def get_completions(self, document: Document, complete_event: object) -> Iterable[Completion]:
            return self._found(document.current_line_before_cursor)

        def _found(self, text: str) -> Iterator[Completion]:
            begun, words = words_for(text, names)
            for word in words:
                yield Completion(word, start_position=-len(begun))

    return OfNames()
