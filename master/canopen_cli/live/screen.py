"""A picture that fills the terminal and is drawn again and again, until q, Ctrl-C, or the end of what it shows.

The picture has a screen of its own: what stood on the terminal comes back when it ends, however it ends. p holds it, which the
picture says; what happens meanwhile is not lost. Each picture is drawn for the size that the terminal has then.

Keys come from the terminal even if standard input is a pipe (`ssh ... candump | canopen top --log -`).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from importlib.util import find_spec
from typing import Final, Generic, TypeVar

import trio
from rich.console import Console, RenderableType
from rich.live import Live

from canopen_cli.shared.running import first_error
from canopen_cli.shared.screen import Screen
from canopen_cli.shared.terminal_keys import END, TerminalKeys, key_by_key, read_terminal
from canopen_transports.loop.beside import beside

S = TypeVar("S")
T = TypeVar("T")

QUIT: Final = ("q", "\x1b", END)
PAUSE: Final = ("p", " ")
LEAST_WIDTH: Final = 20
LEAST_HEIGHT: Final = 5


class LiveScreen(Generic[S]):
    """See this module's text.

    take: returns what is to be shown now. draw: makes the picture of it, for a width and a height; its last argument are the
    seconds since the picture was held, or None. keys: what other keys do. refresh: seconds between two pictures.
    """

    def __init__(
        self,
        screen: Screen,
        take: Callable[[], S],
        draw: Callable[[S, int, int, float | None], RenderableType],
        keys: Mapping[str, Callable[[], None]],
        refresh: float,
    ) -> None:
        self._console = screen.out
        self._take, self._draw, self._keys = take, draw, keys
        self._refresh = refresh
        self._held: tuple[float, S] | None = None
        self._pressed = trio.Event()

    async def during(self, work: Callable[[], Awaitable[T]]) -> T | None:
        """Show the picture while `work` runs. Returns its result; None if a key ended it. Raises what it raises."""
        results: list[T] = []
        with _terminal() as terminal, _own_screen(self._console) as live:
            async with first_error(), beside(trio.open_nursery()) as nursery:
                nursery.start_soon(self._paint, live)
                if terminal is not None:
                    keys = TerminalKeys(partial(read_terminal, terminal))
                    nursery.start_soon(self._follow_keys, keys, nursery.cancel_scope)
                results.append(await work())
        return results[0] if results else None

    async def _paint(self, live: Live) -> None:
        while True:
            self._pressed = trio.Event()
            live.update(self._picture(), refresh=True)
            with trio.move_on_after(self._refresh):
                await self._pressed.wait()

    def _picture(self) -> RenderableType:
        width, height = max(LEAST_WIDTH, self._console.width), max(LEAST_HEIGHT, self._console.height)
        if self._held is None:
            return self._draw(self._take(), width, height, None)
        since, shown = self._held
        return self._draw(shown, width, height, trio.current_time() - since)

    async def _follow_keys(self, keys: TerminalKeys, scope: trio.CancelScope) -> None:
        while True:
            key = await keys.next()
            if key in QUIT:
                scope.cancel()
                return
            if key in PAUSE:
                self._held = (trio.current_time(), self._take()) if self._held is None else None
            elif key in self._keys:
                self._keys[key]()
            self._pressed.set()


@contextmanager
def _own_screen(console: Console) -> Iterator[Live]:
    live = Live(console=console, screen=True, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)
    with live:
        yield live


@contextmanager
def _terminal() -> Iterator[int | None]:
    """Have a terminal give each key at once; its file descriptor, or None if there is none to ask."""
    if find_spec("termios") is None:
        yield None
        return
    opened = None
    if sys.stdin.isatty():
        terminal = sys.stdin.fileno()
    else:
        try:
            terminal = opened = os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY)
        except OSError:
            yield None
            return
    try:
        with key_by_key(terminal):
            yield terminal
    finally:
        if opened is not None:
            with suppress(OSError):
                os.close(opened)
